"""CDR, little-endian, as ROS 2 writes it: numbers aligned to their size, counted from behind the
four bytes of header."""

from __future__ import annotations

import struct
from typing import Final

from amr_slam.wire import WireError

HEADER: Final = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian, no options."""


class CdrWriter:
    """Appends fields in the order of the message's definition."""

    def __init__(self) -> None:
        self._buffer = bytearray(HEADER)

    def uint8(self, value: int) -> None:
        self._buffer.append(value)

    def int32(self, value: int) -> None:
        self._align(4)
        self._buffer += struct.pack("<i", value)

    def uint32(self, value: int) -> None:
        """Also the length of a sequence."""
        self._align(4)
        self._buffer += struct.pack("<I", value)

    def float32(self, value: float) -> None:
        self._align(4)
        self._buffer += struct.pack("<f", value)

    def float64s(self, *values: float) -> None:
        """Several in a row, at least one."""
        self._align(8)
        self._buffer += struct.pack(f"<{len(values)}d", *values)

    def string(self, text: str) -> None:
        """UTF-8, with the length in front and a zero behind."""
        encoded = text.encode()
        self.uint32(len(encoded) + 1)
        self._buffer += encoded + b"\x00"

    def raw(self, octets: bytes) -> None:
        """Elements of a sequence of bytes; its length goes before."""
        self._buffer += octets

    def bytes(self) -> bytes:
        return bytes(self._buffer)

    def _align(self, size: int) -> None:
        if padding := -(len(self._buffer) - len(HEADER)) % size:
            self._buffer += bytes(padding)


class CdrReader:
    """Takes fields in the same order. Every method raises WireError where the payload ends."""

    def __init__(self, payload: bytes) -> None:
        """Raises WireError for another representation than :data:`HEADER`'s."""
        # The last byte tells how much padding is at the end: nothing that a reader needs.
        if len(payload) < len(HEADER) or payload[:3] != HEADER[:3]:
            raise WireError("no little-endian CDR")
        self._payload = payload
        self._at = len(HEADER)

    def int32(self) -> int:
        (value,) = self._numbers("i", 1, 4)
        return int(value)

    def uint32(self) -> int:
        (value,) = self._numbers("I", 1, 4)
        return int(value)

    def float64s(self, count: int) -> tuple[float, ...]:
        return self._numbers("d", count, 8)

    def string(self, max_length: int) -> str:
        """Raises WireError, too, when it is longer than ``max_length`` bytes or no UTF-8."""
        size = self.uint32()
        if not 1 <= size <= max_length + 1:
            raise WireError(f"a string of {size} bytes, at most {max_length}")
        encoded = self._take(size)
        if encoded[-1] != 0:
            raise WireError("a string without its end")
        try:
            return encoded[:-1].decode()
        except UnicodeDecodeError as error:
            raise WireError("a string that is no UTF-8") from error

    def end(self) -> None:
        """Raises WireError when more than padding is left."""
        if len(self._payload) - self._at > 3:
            raise WireError(f"{len(self._payload) - self._at} bytes too many")

    def _numbers(self, code: str, count: int, size: int) -> tuple[float, ...]:
        self._at += -(self._at - len(HEADER)) % size
        return struct.unpack(f"<{count}{code}", self._take(count * size))

    def _take(self, size: int) -> bytes:
        taken = self._payload[self._at : self._at + size]
        if len(taken) < size:
            raise WireError("the payload ends too early")
        self._at += size
        return taken
