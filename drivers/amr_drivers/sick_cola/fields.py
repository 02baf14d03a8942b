"""The fields of CoLa telegrams, read and written in either dialect. Pure.

CoLa B: big-endian integers and IEEE floats one after the other. CoLa A: the same fields as tokens
between blanks; hexadecimal without a sign, decimal with one, floats as the hexadecimal digits of
their IEEE pattern (fact sheet, B.1 and B.4). A :class:`Fields` hides the difference, so that each
telegram's layout is written down once.
"""

from __future__ import annotations

import re
import struct
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.framing import Dialect
from amr_slam.geometry import readonly

Words = NDArray[np.uint16]

_HEX_OR_BLANK = b"0123456789abcdefABCDEF "
_TOKEN = re.compile(rb"[0-9A-Fa-f]{1,8}|[+-][0-9]{1,10}")
_TEXT = "latin-1"


class Fields(Protocol):
    """Reads fields in their order. All methods raise BadTelegram where the bytes are no such."""

    def unsigned(self, bits: Literal[8, 16, 32]) -> int: ...

    def signed(self, bits: Literal[16, 32]) -> int: ...

    def real(self) -> float:
        """A 32-bit float."""

    def letters(self, count: int) -> str:
        """So many characters, as a name that is not preceded by its length."""

    def text(self, length_bits: Literal[8, 16] = 16) -> str:
        """A text preceded by its length, which has so many bits in CoLa B."""

    def values(self, count: int, bits: Literal[8, 16]) -> Words:
        """(count,) unsigned values."""

    def end(self) -> None:
        """Nothing must be left."""

    def mark(self) -> int:
        """The present place, for :meth:`back_to`."""

    def back_to(self, mark: int) -> None: ...


class BinaryFields:
    """:class:`Fields` of CoLa B."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def unsigned(self, bits: Literal[8, 16, 32]) -> int:
        return int.from_bytes(self._take(bits // 8), "big")

    def signed(self, bits: Literal[16, 32]) -> int:
        return int.from_bytes(self._take(bits // 8), "big", signed=True)

    def real(self) -> float:
        return float(struct.unpack(">f", self._take(4))[0])

    def letters(self, count: int) -> str:
        return _printable(self._take(count))

    def text(self, length_bits: Literal[8, 16] = 16) -> str:
        return _printable(self._take(self.unsigned(length_bits)))

    def values(self, count: int, bits: Literal[8, 16]) -> Words:
        data = self._take(count * bits // 8)
        return readonly(np.frombuffer(data, dtype=">u2" if bits == 16 else "u1"), np.uint16)

    def end(self) -> None:
        if self._at != len(self._data):
            raise BadTelegram(f"{len(self._data) - self._at} bytes too many")

    def mark(self) -> int:
        return self._at

    def back_to(self, mark: int) -> None:
        self._at = mark

    def _take(self, count: int) -> bytes:
        data = self._data[self._at : self._at + count]
        if len(data) < count:
            raise BadTelegram(f"cut short: {count - len(data)} bytes are missing")
        self._at += count
        return data


class TextFields:
    """:class:`Fields` of CoLa A."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def unsigned(self, bits: Literal[8, 16, 32]) -> int:
        value = self._number()
        if not 0 <= value < 1 << bits:
            raise BadTelegram(f"{value} does not fit into {bits} bits")
        return value

    def signed(self, bits: Literal[16, 32]) -> int:
        value = self._number()
        half = 1 << (bits - 1)
        if not -half <= value < 2 * half:
            raise BadTelegram(f"{value} does not fit into {bits} bits")
        return value - 2 * half if value >= half else value

    def real(self) -> float:
        return float(struct.unpack(">f", self.unsigned(32).to_bytes(4, "big"))[0])

    def letters(self, count: int) -> str:
        token = self._token()
        if len(token) != count:
            raise BadTelegram(f"{_printable(token)!r} has not {count} characters")
        return _printable(token)

    def text(self, length_bits: Literal[8, 16] = 16) -> str:
        length = self.unsigned(length_bits)
        # By its length, not up to a blank: the default name is "not defined".
        text = self._data[self._at : self._at + length]
        behind = self._data[self._at + length : self._at + length + 1]
        if len(text) < length or behind not in (b"", b" "):
            raise BadTelegram(f"no text of {length} characters")
        self._at += length + 1
        return _printable(text)

    def values(self, count: int, bits: Literal[8, 16]) -> Words:
        if count == 0:
            return readonly(np.zeros(0), np.uint16)
        if len(self._data) - self._at < 2 * count - 1:
            raise BadTelegram(f"cut short: no {count} values are left")
        parts = self._data[self._at :].split(b" ", count)
        rest = len(parts.pop()) if len(parts) > count else -1
        if len(parts) < count:
            raise BadTelegram(f"cut short: {len(parts)} values instead of {count}")
        numbers = _numbers(parts)
        if not 0 <= min(numbers) <= max(numbers) < 1 << bits:
            raise BadTelegram(f"a value does not fit into {bits} bits")
        self._at = len(self._data) - rest
        return readonly(np.array(numbers), np.uint16)

    def end(self) -> None:
        if self._data[self._at :].strip(b" "):
            raise BadTelegram(f"{len(self._data) - self._at} characters too many")

    def mark(self) -> int:
        return self._at

    def back_to(self, mark: int) -> None:
        self._at = mark

    def _token(self) -> bytes:
        if self._at >= len(self._data):
            raise BadTelegram("cut short: a field is missing")
        end = self._data.find(b" ", self._at)
        end = len(self._data) if end < 0 else end
        token = self._data[self._at : end]
        self._at = end + 1
        return token

    def _number(self) -> int:
        return _number(self._token())


def _number(token: bytes) -> int:
    if not _TOKEN.fullmatch(token):
        raise BadTelegram(f"{token[:16]!r} is no number")
    return int(token, 10 if token[:1] in (b"+", b"-") else 16)


def _numbers(tokens: list[bytes]) -> list[int]:
    # The usual case in one go: int() alone would take blanks, underscores and signs as well.
    if all(tokens) and not b" ".join(tokens).translate(None, _HEX_OR_BLANK):
        return [int(token, 16) for token in tokens]
    return [_number(token) for token in tokens]


def _printable(data: bytes) -> str:
    text = data.decode(_TEXT)
    if not text.isprintable():
        raise BadTelegram(f"{data[:16]!r} is no text")
    return text


class FieldWriter(Protocol):
    """Writes what :class:`Fields` reads."""

    def unsigned(self, value: int, bits: Literal[8, 16, 32]) -> None: ...

    def signed(self, value: int, bits: Literal[16, 32]) -> None: ...

    def real(self, value: float) -> None: ...

    def letters(self, text: str) -> None: ...

    def text(self, text: str, length_bits: Literal[8, 16] = 16) -> None: ...

    def values(self, values: Words, bits: Literal[8, 16]) -> None: ...

    def data(self) -> bytes:
        """All that was written."""


class BinaryWriter:
    """:class:`FieldWriter` of CoLa B."""

    def __init__(self) -> None:
        self._data = bytearray()

    def unsigned(self, value: int, bits: Literal[8, 16, 32]) -> None:
        self._data += value.to_bytes(bits // 8, "big")

    def signed(self, value: int, bits: Literal[16, 32]) -> None:
        self._data += value.to_bytes(bits // 8, "big", signed=True)

    def real(self, value: float) -> None:
        self._data += struct.pack(">f", value)

    def letters(self, text: str) -> None:
        self._data += text.encode(_TEXT)

    def text(self, text: str, length_bits: Literal[8, 16] = 16) -> None:
        self.unsigned(len(text), length_bits)
        self.letters(text)

    def values(self, values: Words, bits: Literal[8, 16]) -> None:
        self._data += values.astype(">u2" if bits == 16 else "u1").tobytes()

    def data(self) -> bytes:
        return bytes(self._data)


class TextWriter:
    """:class:`FieldWriter` of CoLa A."""

    def __init__(self) -> None:
        self._tokens: list[str] = []

    def unsigned(self, value: int, bits: Literal[8, 16, 32]) -> None:
        self._tokens.append(f"{value % (1 << bits):X}")

    def signed(self, value: int, bits: Literal[16, 32]) -> None:
        self._tokens.append(f"{value % (1 << bits):X}")

    def real(self, value: float) -> None:
        self._tokens.append(struct.pack(">f", value).hex().upper())

    def letters(self, text: str) -> None:
        self._tokens.append(text)

    def text(self, text: str, length_bits: Literal[8, 16] = 16) -> None:
        self.unsigned(len(text), length_bits)
        self._tokens.append(text)

    def values(self, values: Words, bits: Literal[8, 16]) -> None:  # noqa: ARG002 - one text for both
        self._tokens += [f"{value:X}" for value in values.tolist()]

    def data(self) -> bytes:
        return " ".join(self._tokens).encode(_TEXT)


def fields(data: bytes, dialect: Dialect) -> Fields:
    """The fields in a telegram's arguments."""
    return TextFields(data) if dialect is Dialect.A else BinaryFields(data)


def writer(dialect: Dialect) -> FieldWriter:
    """An empty list of arguments."""
    return TextWriter() if dialect is Dialect.A else BinaryWriter()
