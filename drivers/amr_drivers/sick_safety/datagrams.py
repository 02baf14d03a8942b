"""UDP datagrams of an instance: fragments to the whole and back, no I/O.

Source: protocol fact sheet, section C.4. Everything is little-endian but the marks. Fragments
come in any order, doubled, or not at all; UDP's checksum is all that guards the bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from amr_drivers.errors import BadTelegram

_MARK: Final = b"MS3 MD"
_HEAD: Final = struct.Struct("<4s2sBBIII4x")
HEADER: Final = _HEAD.size
_MAJOR: Final = 1
_SHORTEST_INSTANCE: Final = 52
MAX_INSTANCE: Final = 32_768
"""Longest instance believed, in bytes: 2751 beams and all other blocks need 20 000."""
MAX_OPEN: Final = 4
"""Instances that may be unfinished at a time; the oldest is given up for the next."""
_KEPT: Final = 4
"""Finished instances that are remembered, so that their doubled fragments are known as such."""
_PATIENCE_NS: Final = 1_000_000_000
"""An instance's fragments are sent within a scan period: one that lacks some for longer is lost."""
_COVERED: Final = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Fragment:
    """One datagram."""

    identification: int
    """The same in all fragments of an instance, counted on from one to the next."""
    total: int
    """Length of the instance, in bytes."""
    offset: int
    """Where in the instance these bytes belong."""
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Assembled:
    """An instance whose every byte has arrived."""

    identification: int
    stamp_ns: int
    """Arrival of the first of its fragments that came."""
    data: bytes


def encode_fragment(fragment: Fragment) -> bytes:
    """The datagram."""
    head = _HEAD.pack(
        _MARK[:4], _MARK[4:], _MAJOR, 0, fragment.total, fragment.identification, fragment.offset
    )
    return head + fragment.data


def decode_fragment(datagram: bytes) -> Fragment:
    """The fragment in a datagram. Raises BadTelegram when it is none."""
    if len(datagram) <= HEADER:
        raise BadTelegram(f"a datagram of {len(datagram)} bytes holds no data")
    mark, kind, major, _, total, identification, offset = _HEAD.unpack_from(datagram)
    if mark + kind != _MARK:
        raise BadTelegram(f"a datagram that begins with {datagram[:6]!r} is not a safety scanner's")
    if major != _MAJOR:
        raise BadTelegram(f"datagrams of version {major} are unknown")
    if not _SHORTEST_INSTANCE <= total <= MAX_INSTANCE:
        raise BadTelegram(f"no instance has {total} bytes")
    data = datagram[HEADER:]
    if offset + len(data) > total:
        raise BadTelegram(f"{len(data)} bytes at {offset} lie beyond an instance of {total}")
    return Fragment(identification=identification, total=total, offset=offset, data=data)


def fragments(data: bytes, identification: int, size: int = 1460) -> list[bytes]:
    """An instance as datagrams of at most ``size`` bytes (more than HEADER), in order."""
    step = size - HEADER
    return [
        encode_fragment(
            Fragment(
                identification=identification,
                total=len(data),
                offset=start,
                data=data[start : start + step],
            )
        )
        for start in range(0, len(data), step)
    ]


class _Unfinished:
    def __init__(self, total: int, stamp_ns: int) -> None:
        self.stamp_ns = stamp_ns
        self.data = bytearray(total)
        self._covered = bytearray(total)

    @property
    def whole(self) -> bool:
        return self._covered.count(_COVERED) == len(self._covered)

    def agrees(self, fragment: Fragment) -> bool:
        """Whether nothing that is here already says otherwise."""
        if fragment.total != len(self.data):
            return False
        span = slice(fragment.offset, fragment.offset + len(fragment.data))
        here = self._covered[span]
        if not here.count(_COVERED):
            return True
        pairs = zip(here, self.data[span], fragment.data, strict=True)
        return all(not covered or old == new for covered, old, new in pairs)

    def place(self, fragment: Fragment) -> None:
        span = slice(fragment.offset, fragment.offset + len(fragment.data))
        self.data[span] = fragment.data
        self._covered[span] = bytes((_COVERED,)) * len(fragment.data)


class Reassembler:
    """Puts instances together.

    Fragments may come in any order, overlap and come again; an instance whose fragments contradict
    each other is given up. Memory stays below (2 * MAX_OPEN + _KEPT) * MAX_INSTANCE.
    """

    def __init__(self) -> None:
        self._open: dict[int, _Unfinished] = {}
        self._finished: dict[int, bytes] = {}
        self._lost = 0
        self._refused = 0

    @property
    def lost(self) -> int:
        """Instances that were begun and given up."""
        return self._lost

    @property
    def refused(self) -> int:
        """Datagrams that are no fragments, or contradict others."""
        return self._refused

    @property
    def held_bytes(self) -> int:
        """Of unfinished and remembered instances."""
        unfinished = sum(2 * len(instance.data) for instance in self._open.values())
        return unfinished + sum(map(len, self._finished.values()))

    def feed(self, datagram: bytes, stamp_ns: int) -> Assembled | None:
        """Take in a datagram; the instance that it completes. Raises BadTelegram: no fragment, or
        one that contradicts others of its instance (which is given up)."""
        try:
            fragment = decode_fragment(datagram)
        except BadTelegram:
            self._refused += 1
            raise
        self._forget_unfinished_since(stamp_ns - _PATIENCE_NS)
        if self._is_repeated(fragment):
            return None
        return self._take(fragment, stamp_ns)

    def reset(self) -> None:
        """Datagrams were thrown away: what is unfinished stays so."""
        self._lost += len(self._open)
        self._open.clear()

    def _take(self, fragment: Fragment, stamp_ns: int) -> Assembled | None:
        number = fragment.identification
        instance = self._open.get(number)
        if instance is None:
            while len(self._open) >= MAX_OPEN:
                self._give_up(next(iter(self._open)))
            instance = self._open[number] = _Unfinished(fragment.total, stamp_ns)
        if not instance.agrees(fragment):
            self._give_up(number)
            self._refused += 1
            raise BadTelegram(f"two fragments of instance {number} contradict each other")
        instance.place(fragment)
        if not instance.whole:
            return None
        return self._finish(number)

    def _finish(self, number: int) -> Assembled:
        instance = self._open[number]
        # Older ones lack a fragment that was sent before: it will not come any more.
        for begun in list(self._open):
            if begun == number:
                break
            self._give_up(begun)
        del self._open[number]
        data = bytes(instance.data)
        self._finished[number] = data
        if len(self._finished) > _KEPT:
            del self._finished[next(iter(self._finished))]
        return Assembled(identification=number, stamp_ns=instance.stamp_ns, data=data)

    def _is_repeated(self, fragment: Fragment) -> bool:
        """Whether it belongs to a finished instance. A device that was switched off and on uses
        the same identifications for other data."""
        data = self._finished.get(fragment.identification)
        if data is None:
            return False
        if len(data) == fragment.total and data.startswith(fragment.data, fragment.offset):
            return True
        del self._finished[fragment.identification]
        return False

    def _forget_unfinished_since(self, limit_ns: int) -> None:
        for number in [n for n, begun in self._open.items() if begun.stamp_ns < limit_ns]:
            self._give_up(number)

    def _give_up(self, number: int) -> None:
        del self._open[number]
        self._lost += 1
