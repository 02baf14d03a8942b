"""The newest messages of a recording, kept in memory within bounds until somebody wants them.

Packed and compressed: a thousand small reads a second as objects would take ten times the room.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import zstandard

from amr_slam.recording.messages import Entry

_HEAD = struct.Struct("<HQI")
_PART_BYTES = 64 << 10
_LEVEL = 1
_UNPACKED_BYTES = 1 << 30
"""A ring never unpacks to more: half of what a recording may hold to be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """What a ring held at one moment."""

    topics: tuple[tuple[str, str], ...]
    """(topic, schema) by the number that stands in the parts."""
    packed: tuple[bytes, ...]

    @property
    def size_bytes(self) -> int:
        """Packed as it is; a file of it is about as large."""
        return sum(map(len, self.packed))

    def parts(self) -> Iterator[list[Entry]]:
        """The messages in their order, about 64 KiB at a time."""
        for packed in self.packed:
            data = zstandard.decompress(packed)
            entries, at = [], 0
            while at < len(data):
                number, stamp_ns, length = _HEAD.unpack_from(data, at)
                at += _HEAD.size + length
                topic, schema = self.topics[number]
                entries.append(Entry(topic, schema, stamp_ns, data[at - length : at]))
            yield entries


class Ring:
    """Bounded in time and bytes; the oldest goes first. For one thread."""

    def __init__(self, span_s: float, max_bytes: int) -> None:
        self._span_ns = round(1e9 * span_s)
        self._max_bytes = max_bytes
        self._numbers: dict[tuple[str, str], int] = {}
        self._open = bytearray()
        self._parts: deque[tuple[int, int, bytes]] = deque()
        self._bytes = self._unpacked = 0
        self._compressor = zstandard.ZstdCompressor(level=_LEVEL)

    @property
    def used_bytes(self) -> int:
        """Of memory, by the messages."""
        return self._bytes + len(self._open)

    def add(self, entries: Iterable[Entry], now_ns: int) -> None:
        """Keep these; forget what was complete ``span_s`` before ``now_ns`` or is too much."""
        for entry in entries:
            topic = entry.topic, entry.schema
            number = self._numbers.setdefault(topic, len(self._numbers))
            self._open += _HEAD.pack(number, entry.stamp_ns, len(entry.data))
            self._open += entry.data
            if len(self._open) >= _PART_BYTES:
                self._close_part(now_ns)
        while self._parts and (
            self._parts[0][0] < now_ns - self._span_ns
            or self.used_bytes > self._max_bytes
            or self._unpacked > _UNPACKED_BYTES
        ):
            _, length, packed = self._parts.popleft()
            self._bytes -= len(packed)
            self._unpacked -= length

    def kept(self, now_ns: int) -> Kept:
        """All that is held; what is added later does not change it."""
        if self._open:
            self._close_part(now_ns)
        return Kept(topics=tuple(self._numbers), packed=tuple(packed for *_, packed in self._parts))

    def _close_part(self, now_ns: int) -> None:
        packed = self._compressor.compress(bytes(self._open))
        self._parts.append((now_ns, len(self._open), packed))
        self._bytes += len(packed)
        self._unpacked += len(self._open)
        self._open.clear()
