"""A SICK S300 on a pseudo-terminal."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.sick_s300.telegrams import (
    Output,
    Telegram,
    encode,
    encode_words,
    standby_words,
    words_from_ranges,
)
from amr_slam.geometry import Array

_CHUNK = 62
"""Bytes that an FTDI adapter delivers at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class S300Model:
    """Which S300 to be."""

    version: Literal[0x0102, 0x0103] = 0x0103
    length_rule: Literal[4, 8, 14] = 14
    """4 for version 0x0102; 8 or 14 for 0x0103 without and with a measuring field."""
    address: Literal[7, 8] = 7
    number_order: Literal["little", "big"] = "little"
    baud_rate: int = 500_000
    paced: bool = False
    """Send at the baud rate (``send`` lasts as long as the wire), not at once."""


class EmulatedS300:
    """The scanner's end of the line, with the faults that real ones have.

    One thread sends. ``mode`` and ``silent`` may be set at any time; a context manager.
    """

    def __init__(self, link: Path | None = None, model: S300Model | None = None) -> None:
        self.mode: Literal["measuring", "standby", "lock-out"] = "measuring"
        self.silent = False
        """True: the scanner measures and counts on but nothing is sent."""
        self._model = model or S300Model()
        self._line = PtyLine(link)
        self._number = 0
        self._cut_at: int | None = None

    @property
    def port(self) -> str:
        """The path that the driver opens."""
        return self._line.port

    @property
    def scan_number(self) -> int:
        """Number of the newest scan; the next ``send`` counts on from here."""
        return self._number

    def send(self, ranges_m: Array, scan_number: int | None = None) -> int:
        """Send one scan: ranges in m, counter-clockwise; inf no return, NaN not measured.

        To be called when the sweep ends. Returns the monotonic nanoseconds at which the first
        byte left: the truth for the driver's stamp, the sweep's duration later than it.
        ``scan_number`` (default: the last plus 1) lets a test repeat or skip.
        """
        self._number = (self._number + 1 if scan_number is None else scan_number) % 2**32
        data = self.telegram(ranges_m)
        if self._cut_at is not None:
            data, self._cut_at = data[: self._cut_at], None
        start_ns = time.monotonic_ns()
        if self.silent:
            return start_ns
        if not self._model.paced:
            self._line.write(data)
            return start_ns
        for begin in range(0, len(data), _CHUNK):
            chunk = data[begin : begin + _CHUNK]
            self._line.write(chunk)
            # Against the start, not the last chunk: delays must not add up.
            due_ns = start_ns + (begin + len(chunk)) * 10_000_000_000 // self._model.baud_rate
            time.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
        return start_ns

    def telegram(self, ranges_m: Array) -> bytes:
        """The bytes of a scan with the present number and mode."""
        words = words_from_ranges(ranges_m)
        if self.mode == "standby":
            words = standby_words(len(words))
        return encode(
            Telegram(
                address=self._model.address,
                version=self._model.version,
                status=int(self.mode == "lock-out"),
                scan_number=self._number.to_bytes(4, self._model.number_order),
                telegram_number=(self._number % 2**16).to_bytes(2, self._model.number_order),
                output=Output.MEASURED,
                payload=encode_words(words),
            ),
            self._model.length_rule,
        )

    def send_bytes(self, data: bytes) -> None:
        """Send anything: I/O telegrams, a recording, damage."""
        self._line.write(data)

    def send_garbage(self, count: int, seed: int) -> None:
        """Send random bytes, half of them zero as in headers."""
        dice = random.Random(seed)
        self._line.write(bytes(dice.choice((0, dice.randrange(256))) for _ in range(count)))

    def cut_next(self, at_byte: int) -> None:
        """Let the next telegram end early."""
        self._cut_at = at_byte

    def unplug(self) -> None:
        """Pull the cable: the port hangs up and disappears."""
        self._line.unplug()

    def replug(self) -> None:
        """Put it back: the port returns under the same link."""
        self._line.plug()

    def close(self) -> None:
        self._line.unplug()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
