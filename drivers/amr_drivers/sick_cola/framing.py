"""CoLa A and CoLa B frames in a byte stream, both ways. No I/O (fact sheet, B.1).

::

    CoLa A   02 text 03                                              no checksum
    CoLa B   02 02 02 02  length u32 big-endian  payload  checksum   XOR of the payload's bytes

A payload begins with a command word in both: ``sRN``, ``sRA``, ``sSN``, ``sFA``, ... CoLa A's
has no bytes below a blank, which is how the dialects are told apart.
"""

from __future__ import annotations

import enum
import functools
import operator
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

MAX_PAYLOAD_B = 0xFFFF
"""Longest CoLa B payload believed, in bytes: five echoes of an LMS5xx with their intensities need
22 931, the longest seen in a recording has 3544."""
MAX_PAYLOAD_A = 2 * 0xFFFF
"""The same five echoes take up to 57 kB as text."""

_HEADER_B = 8
_MAGIC_B = b"\x02\x02\x02\x02"
_WORDS = rb"s(?:FA|[RW][NA]|[MA]N|E[NA]|SN)"
_START_B = re.compile(rb"\x02{4}\x00\x00.." + _WORDS, re.DOTALL)
_START_B_LENGTH = 11
_START_A = re.compile(rb"\x02" + _WORDS + rb"(?=[ \x03])")
_START_A_LENGTH = 5
_NO_TEXT = re.compile(rb"[\x00-\x1f]")


class Dialect(enum.StrEnum):
    """How a device's telegrams are written."""

    A = "a"
    """Text."""
    B = "b"
    """Binary."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One telegram without what frames it."""

    dialect: Dialect
    payload: bytes
    offset: int
    """Position of the frame's first byte in the stream."""


def framed(payload: bytes, dialect: Dialect) -> bytes:
    """The bytes of a telegram. Raises ValueError for a payload that no frame can hold."""
    if dialect is Dialect.A:
        if len(payload) > MAX_PAYLOAD_A or _NO_TEXT.search(payload):
            raise ValueError("not a text that fits into CoLa A")
        return b"\x02" + payload + b"\x03"
    if len(payload) > MAX_PAYLOAD_B:
        raise ValueError(f"{len(payload)} bytes are too many for a telegram")
    return _MAGIC_B + len(payload).to_bytes(4, "big") + payload + bytes((checksum(payload),))


def checksum(payload: bytes | bytearray) -> int:
    """XOR of all bytes."""
    # Folded in halves: whole integers are a hundred times as fast as a loop over bytes.
    number, length = int.from_bytes(payload, "big"), len(payload)
    if length < 64:
        return functools.reduce(operator.xor, payload, 0)
    while length > 1:
        half = length // 2
        number = (number >> 8 * half) ^ (number & (1 << 8 * half) - 1)
        length -= half
    return number


class FrameReader(Protocol):
    """Finds frames in a byte stream, whatever the pieces in which it comes.

    Damage is skipped byte by byte; memory stays below two of the longest frames.
    """

    @property
    def damaged(self) -> int:
        """Runs of bytes that were skipped, a long run counted once in the longest frame's bytes.

        The piece of a telegram with which a stream begins is no damage.
        """

    @property
    def pending(self) -> int:
        """Position in the stream of the first byte that may still become a frame."""

    @property
    def position(self) -> int:
        """Position in the stream of the next byte to be fed."""

    def feed(self, data: bytes) -> list[Frame]:
        """Take in the next bytes; the frames that they complete, in order."""

    def reset(self) -> None:
        """Forget an unfinished frame, as after bytes were lost."""


class _Reader(ABC):
    """What both dialects have in common: a buffer, and counting what is skipped."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._buffer = bytearray()
        self._offset = 0
        self._damaged = 0
        self._restart()

    @property
    def damaged(self) -> int:
        return self._damaged

    @property
    def pending(self) -> int:
        return self._offset

    @property
    def position(self) -> int:
        return self._offset + len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        found: list[Frame] = []
        for start in range(0, len(data), self._longest):
            self._buffer += data[start : start + self._longest]
            while (frame := self._next()) is not None:
                found.append(frame)
        return found

    def reset(self) -> None:
        self._drop(len(self._buffer))
        self._restart()

    def _restart(self) -> None:
        self._skipped = 0
        self._synchronised = False
        self._searched = 0

    @abstractmethod
    def _next(self) -> Frame | None:
        """Take the next whole frame out of the buffer; None: it holds none yet."""

    def _found(self, dialect: Dialect, payload: bytes, length: int) -> Frame:
        frame = Frame(dialect, payload, self._offset)
        self._drop(length)
        self._skipped, self._synchronised, self._searched = 0, True, 0
        return frame

    def _skip(self, count: int) -> None:
        if count <= 0:
            return
        if self._synchronised and self._skipped == 0:
            self._damaged += 1
        before, self._skipped = self._skipped, self._skipped + count
        self._damaged += self._skipped // self._longest - before // self._longest
        self._drop(count)
        self._searched = 0

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._offset += count


class ColaBReader(_Reader):
    """A :class:`FrameReader` of CoLa B.

    Five 02 in a row are a checksum of 02 before a header: the header is where the length's high
    bytes are zero. A header within a frame's bytes means that the frame was cut short.
    """

    def __init__(self) -> None:
        super().__init__(_HEADER_B + MAX_PAYLOAD_B + 1)

    def _next(self) -> Frame | None:
        buffer = self._buffer
        while True:
            match = _START_B.search(buffer)
            if match is None:
                self._skip(len(buffer) - (_START_B_LENGTH - 1))
                return None
            self._skip(match.start())
            length = _HEADER_B + int.from_bytes(buffer[4:_HEADER_B], "big") + 1
            inner = _START_B.search(buffer, max(_HEADER_B, self._searched), length)
            if inner is None and len(buffer) < length:
                self._searched = len(buffer) - (_START_B_LENGTH - 1)
                return None
            payload = bytes(buffer[_HEADER_B : length - 1])
            if inner is None and len(payload) >= 3 and checksum(payload) == buffer[length - 1]:
                return self._found(Dialect.B, payload, length)
            self._skip(1)


class ColaAReader(_Reader):
    """A :class:`FrameReader` of CoLa A. Any byte below a blank but the end ends a frame early."""

    def __init__(self) -> None:
        super().__init__(MAX_PAYLOAD_A + 2)

    def _next(self) -> Frame | None:
        buffer = self._buffer
        while True:
            match = _START_A.search(buffer)
            if match is None:
                self._skip(len(buffer) - (_START_A_LENGTH - 1))
                return None
            self._skip(match.start())
            end = _NO_TEXT.search(buffer, max(1, self._searched))
            if end is None and len(buffer) < MAX_PAYLOAD_A + 2:
                self._searched = len(buffer)
                return None
            if end is not None and end.group() == b"\x03" and end.start() <= MAX_PAYLOAD_A + 1:
                return self._found(Dialect.A, bytes(buffer[1 : end.start()]), end.end())
            self._skip(1)


class AnyReader:
    """A :class:`FrameReader` of the dialect of which it sees the first frame."""

    def __init__(self) -> None:
        self._candidates: list[tuple[Dialect, FrameReader]] = [
            (Dialect.B, ColaBReader()),
            (Dialect.A, ColaAReader()),
        ]

    @property
    def dialect(self) -> Dialect | None:
        """None before the first frame."""
        return self._candidates[0][0] if len(self._candidates) == 1 else None

    @property
    def damaged(self) -> int:
        return min(reader.damaged for _, reader in self._candidates)

    @property
    def pending(self) -> int:
        return min(reader.pending for _, reader in self._candidates)

    @property
    def position(self) -> int:
        return self._candidates[0][1].position

    def feed(self, data: bytes) -> list[Frame]:
        for candidate in self._candidates:
            frames = candidate[1].feed(data)
            if frames:
                self._candidates = [candidate]
                return frames
        return []

    def reset(self) -> None:
        for _, reader in self._candidates:
            reader.reset()


def reader(dialect: Dialect) -> FrameReader:
    """A reader of one dialect."""
    return ColaAReader() if dialect is Dialect.A else ColaBReader()
