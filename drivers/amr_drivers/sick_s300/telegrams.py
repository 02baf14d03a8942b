"""Telegrams of SICK S300 and S3000 in continuous mode: bytes to values and back, no I/O.

Source: protocol fact sheet, sections A.2 to A.5 and A.8. Sizes are big-endian words, everything
else little-endian; the scan number's order differs between sources and is found from the stream
(:class:`amr_drivers.sick_s300.scan_counter.ScanCounter`).

A damaged telegram passes a 16-bit CRC once in 65 536 times. So that it does not become a scan, a
telegram must also have a known address, version and output, a length that its size field allows,
nothing of the next telegram's header within it, and exactly the number of values that the field of
view has. What is left are changed or added bytes among the values that happen to keep the CRC.
"""

from __future__ import annotations

import binascii
import enum
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_drivers.errors import BadTelegram
from amr_slam.geometry import Array, readonly

MAX_LENGTH = 4096
"""Longest telegram believed, in bytes: an S3000 at 0.25 degrees needs 1548."""
MIN_LENGTH = 28
_HEAD = 22
"""Bytes up to and with the output id."""
_SAME = 12
"""Leading bytes that are the same in all telegrams of one scanner."""
_MEASURED_HEAD = 24
_CRC = 2
_UNCHECKED = 4
"""Leading zero bytes that the CRC does not cover."""

LENGTH_RULES: dict[int, tuple[int, ...]] = {0x0102: (4,), 0x0103: (8, 14)}
"""Protocol version -> possible lengths in bytes beyond twice the size field (A.3).

The header does not tell the two rules of 0x0103 apart; the CRC does."""

HEADER = re.compile(
    rb"\x00{6}..\xff[\x07\x08][\x02\x03]\x01.{8}(?:\xaa\xaa|\xbb\xbb|\xcc\xcc)", re.DOTALL
)
"""Where a telegram may begin."""

_DISTANCE_MASK = 0x1FFF
_NO_RETURN_CM = 2950
"""From here on the scanner means "nothing seen": it reports 29.96 to 30.00 m then."""
RANGE_MAX_M = 0.01 * _NO_RETURN_CM
_STANDBY_WORD = 0x4004


class Output(enum.IntEnum):
    """What a telegram carries."""

    IO = 0xAAAA
    MEASURED = 0xBBBB
    REFLECTORS = 0xCCCC


@dataclass(frozen=True, slots=True, kw_only=True)
class Telegram:
    """One telegram whose CRC holds."""

    address: int
    """7: host or stand-alone scanner, 8: guest."""
    version: int
    """0x0102 or 0x0103."""
    status: int
    """0 normal, 1 lock-out."""
    scan_number: bytes
    """Four bytes as sent; their order is found from the stream."""
    telegram_number: bytes
    """Two bytes as sent."""
    output: Output
    payload: bytes
    """All between the output id and the CRC."""
    offset: int = 0
    """Where its first byte stood in the stream, counted from the reader's first byte."""


def crc16(data: bytes | bytearray | memoryview) -> int:
    """CRC-16 with polynomial 0x1021 and initial value 0xFFFF, not reflected (A.4)."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode(telegram: Telegram, length_rule: int | None = None) -> bytes:
    """The bytes of a telegram; ``length_rule`` is one of its version's LENGTH_RULES.

    Raises BadTelegram for a rule or a payload that no telegram can have.
    """
    rules = LENGTH_RULES[telegram.version]
    extra = rules[0] if length_rule is None else length_rule
    length = _HEAD + len(telegram.payload) + _CRC
    if extra not in rules or length % 2 or not MIN_LENGTH <= length <= MAX_LENGTH:
        raise BadTelegram(f"no telegram has {length} bytes under the length rule +{extra}")
    checked = b"".join(
        (
            b"\x00\x00",
            ((length - extra) // 2).to_bytes(2, "big"),
            bytes((0xFF, telegram.address)),
            telegram.version.to_bytes(2, "little"),
            telegram.status.to_bytes(2, "little"),
            telegram.scan_number,
            telegram.telegram_number,
            telegram.output.to_bytes(2, "little"),
            telegram.payload,
        )
    )
    return bytes(_UNCHECKED) + checked + crc16(checked).to_bytes(2, "little")


def encode_words(words: NDArray[np.uint16], measuring_range: int = 1) -> bytes:
    """The payload of a measured-values telegram: the range's id (1..5), then the value words."""
    return bytes((0x11 * measuring_range,)) * 2 + words.astype("<u2").tobytes()


def words_from_ranges(ranges_m: Array) -> NDArray[np.uint16]:
    """Value words of ranges in m: whole centimetres, NaN as 0, no return as 30 m."""
    filled = np.nan_to_num(ranges_m, nan=0.0, posinf=30.0)
    words: NDArray[np.uint16] = np.rint(100.0 * np.clip(filled, 0.0, 30.0)).astype(np.uint16)
    return words


def standby_words(beams: int) -> NDArray[np.uint16]:
    """What a scanner in standby sends for every beam."""
    return np.full(beams, _STANDBY_WORD, dtype=np.uint16)


def measured_words(telegram: Telegram, beams: int) -> NDArray[np.uint16]:
    """The (beams,) value words of a measured-values telegram.

    Raises BadTelegram for other outputs, an unknown measuring range or another number of values:
    how several measuring ranges share one telegram is not known, so that is refused, too.
    """
    if telegram.output is not Output.MEASURED:
        raise BadTelegram(f"a telegram of {telegram.output.name} holds no measured values")
    measuring_range = telegram.payload[:2]
    if measuring_range not in _MEASURING_RANGES:
        raise BadTelegram(f"measuring range {measuring_range.hex()} is unknown")
    words: NDArray[np.uint16] = readonly(
        np.frombuffer(telegram.payload[2:], dtype="<u2"), np.uint16
    )
    if len(words) != beams:
        raise BadTelegram(f"{len(words)} values instead of {beams}: check the field of view")
    return words


_MEASURING_RANGES = frozenset(bytes((0x11 * n,)) * 2 for n in range(1, 6))


def is_standby(words: NDArray[np.uint16]) -> bool:
    """True when the words say "standby" instead of distances (they would read 4 cm all round)."""
    return bool(np.all(words == _STANDBY_WORD))


def ranges_from_words(words: NDArray[np.uint16]) -> Array:
    """Ranges in m (A.5): +inf for no return, NaN for a raw 0, whose meaning nobody documents."""
    distance_cm = words & _DISTANCE_MASK
    ranges: Array = 0.01 * distance_cm.astype(np.float64)
    ranges[distance_cm >= _NO_RETURN_CM] = np.inf
    ranges[distance_cm == 0] = np.nan
    return ranges


class TelegramReader:
    """Finds telegrams in a byte stream, whatever the pieces in which it comes.

    ``beams`` is the number of values expected: where the size field allows it, only telegrams of
    that length are tried, which leaves nothing to chance between the two rules of 0x0103.
    Damage is skipped byte by byte. Memory stays below two telegrams of MAX_LENGTH, time is linear.
    """

    def __init__(self, beams: int) -> None:
        self._expected = _MEASURED_HEAD + 2 * beams + _CRC
        self._buffer = bytearray()
        self._offset = 0
        self._damaged = 0
        self._restart()

    @property
    def damaged(self) -> int:
        """Runs of bytes that were skipped, a long run counted once in MAX_LENGTH bytes.

        The piece of a telegram with which a stream begins is no damage.
        """
        return self._damaged

    @property
    def pending(self) -> int:
        """Position in the stream of the first byte that may still become a telegram."""
        return self._offset

    @property
    def position(self) -> int:
        """Position in the stream of the next byte to be fed."""
        return self._offset + len(self._buffer)

    def feed(self, data: bytes) -> list[Telegram]:
        """Take in the next bytes; the telegrams that they complete, in order."""
        found: list[Telegram] = []
        for start in range(0, len(data), MAX_LENGTH):
            self._buffer += data[start : start + MAX_LENGTH]
            while (telegram := self._next()) is not None:
                found.append(telegram)
        return found

    def reset(self) -> None:
        """Forget an unfinished telegram, as after bytes were thrown away before this reader."""
        self._offset += len(self._buffer)
        self._buffer.clear()
        self._restart()

    def _restart(self) -> None:
        self._skipped = 0
        self._synchronised = False
        self._at_header = False

    def _next(self) -> Telegram | None:
        while True:
            if not self._at_header:
                match = HEADER.search(self._buffer)
                if match is None:
                    self._skip(len(self._buffer) - (_HEAD - 1))
                    return None
                self._skip(match.start())
                self._at_header, self._inner, self._searched = True, MAX_LENGTH, 1
            length = self._length()
            if length is None:
                return None
            if length:
                return self._take(length)
            self._skip(1)
            self._at_header = False

    def _length(self) -> int | None:
        """Length of the telegram at the buffer's start; 0: none is there; None: cannot tell yet."""
        buffer = self._buffer
        if self._inner == MAX_LENGTH and (match := HEADER.search(buffer, self._searched)):
            self._inner = match.end()
        self._searched = max(1, len(buffer) - (_HEAD - 1))
        for length in self._candidates():
            if self._inner <= length:
                return 0  # cut short: the next telegram's header lies within this one
            if len(buffer) < length:
                return None
            crc = int.from_bytes(buffer[length - _CRC : length], "little")
            if crc16(buffer[_UNCHECKED : length - _CRC]) == crc and not self._runs_on(length):
                return length
        return 0

    def _runs_on(self, length: int) -> bool:
        """True when the bytes end in the beginning of the next header: some before it are lost.

        Less than the zeros and a byte of the size proves nothing: values and CRCs end in zeros.
        """
        tail, head = self._buffer[length - _HEAD : length], bytes(self._buffer[:_SAME])
        return head in tail or any(tail.endswith(head[:n]) for n in range(7, _SAME))

    def _candidates(self) -> list[int]:
        size = int.from_bytes(self._buffer[6:8], "big")
        version = int.from_bytes(self._buffer[10:12], "little")
        lengths = [extra + 2 * size for extra in LENGTH_RULES[version]]
        if self._expected in lengths and self._buffer[20] == Output.MEASURED & 0xFF:
            return [self._expected]
        return [length for length in lengths if MIN_LENGTH <= length <= MAX_LENGTH]

    def _take(self, length: int) -> Telegram:
        raw = bytes(self._buffer[:length])
        telegram = Telegram(
            address=raw[9],
            version=int.from_bytes(raw[10:12], "little"),
            status=int.from_bytes(raw[12:14], "little"),
            scan_number=raw[14:18],
            telegram_number=raw[18:20],
            output=Output(int.from_bytes(raw[20:22], "little")),
            payload=raw[_HEAD : length - _CRC],
            offset=self._offset,
        )
        self._drop(length)
        self._skipped = 0
        self._synchronised = True
        self._at_header = False
        return telegram

    def _skip(self, count: int) -> None:
        if count <= 0:
            return
        if self._synchronised and self._skipped == 0:
            self._damaged += 1
        before, self._skipped = self._skipped, self._skipped + count
        self._damaged += self._skipped // MAX_LENGTH - before // MAX_LENGTH
        self._drop(count)

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._offset += count
