"""The scanner itself: what it measures and answers. No socket."""

from __future__ import annotations

import random
import re
import time
from dataclasses import replace
from typing import Literal

import numpy as np

from amr_drivers.emulators.cola.models import ColaModel
from amr_drivers.sick_cola.fields import Words
from amr_drivers.sick_cola.framing import Dialect
from amr_drivers.sick_cola.messages import (
    FIRMWARE,
    IDENT,
    OUTPUT_RANGE,
    SCAN,
    SERIAL,
    STATE,
    Message,
    OutputRange,
    message,
    number,
    number_body,
    output_range_body,
    refusal,
    texts_body,
)
from amr_drivers.sick_cola.scandata import Channel, DeviceTime, ScanData, encode_scan
from amr_slam.geometry import Array

Mode = Literal["measuring", "standby", "dirty", "contaminated", "error"]

_STATUS = {"dirty": (0, 2), "contaminated": (0, 5), "error": (0, 1)}
_STARTING_SCANS = 7
"""First scans after a start, which real devices mark."""
_DAZZLED = 1
_CODES = 16
_LARGEST = 0xFFFE
_ACCESS_DENIED, _UNKNOWN_VARIABLE, _UNKNOWN_COMMAND, _UNKNOWN_EVENT = 0x01, 0x03, 0x0C, 0x0F


class ColaDevice:
    """Counters, clock and newest scan of one scanner."""

    def __init__(
        self, model: ColaModel, dialect: Dialect, *, started_us: int, no_return_m: float | None
    ) -> None:
        self.model = model
        self.dialect = dialect
        self.mode: Mode = "measuring"
        self.frozen = False
        self.device_name: str | None = None
        self.comment: str | None = None
        self.dated = False
        """Telegrams carry the time block."""
        self._no_return_m = no_return_m
        self._scan: ScanData | None = None
        self._start(started_us)

    def power_cycle(self) -> None:
        """Counters and clock start anew."""
        self._start(0)

    def measure(self, ranges_m: Array) -> int:
        """A sweep has just been worked up; its first beam in monotonic ns."""
        now_ns = time.monotonic_ns()
        model = self.model
        end_ns = now_ns - round(1e9 * model.processing_s)
        first_ns = end_ns - round(1e9 * model.sweep_s)
        self._count += 1
        if not (self.frozen and self._scan is not None):
            told_ns = end_ns if model.told == "end" else first_ns
            self._scan = self._telegram(ranges_m, told_ns, now_ns)
        return first_ns

    def scan(self, word: Literal["sRA", "sSN"]) -> bytes:
        """The newest scan's telegram; without distances when nothing is measured."""
        scan = self._scan or self._telegram(np.zeros(0), time.monotonic_ns(), time.monotonic_ns())
        if self.mode == "standby":
            scan = replace(scan, channels=())
        return message(word, SCAN, encode_scan(scan, self.dialect), self.dialect)

    def subscription(self, request: Message) -> bool | None:
        """Whether a request begins (True) or ends (False) the stream of scans."""
        if request.word != "sEN" or request.name != SCAN:
            return None
        return number(request.body, 8, self.dialect) == 1

    def answer(self, request: Message) -> bytes:
        """What the scanner says to a request. Nobody may write."""
        dialect = self.dialect
        if request.word in ("sWN", "sMN"):
            return refusal(_ACCESS_DENIED, dialect)
        if request.word == "sEN":
            if request.name != SCAN:
                return refusal(_UNKNOWN_EVENT, dialect)
            return message("sEA", SCAN, request.body, dialect)
        if request.word != "sRN":
            return refusal(_UNKNOWN_COMMAND, dialect)
        body = self._variable(request.name)
        if body is None:
            return refusal(_UNKNOWN_VARIABLE, dialect)
        return message("sRA", request.name, body, dialect)

    def _variable(self, name: str) -> bytes | None:
        dialect, model = self.dialect, self.model
        if name in model.unknown:
            return None
        if name == IDENT:
            return texts_body(model.ident, dialect)
        if name in (FIRMWARE, SERIAL):
            text = model.firmware if name == FIRMWARE else str(model.serial_number)
            return texts_body((text,), dialect)
        if name == STATE:
            return number_body({"standby": 3, "error": 2}.get(self.mode, 1), 8, dialect)
        if name == OUTPUT_RANGE:
            last = round(model.start_angle + 1e4 * (model.beams - 1) * model.step_deg)
            part = OutputRange(round(1e4 * model.step_deg), model.start_angle, last)
            return output_range_body(part, dialect)
        return None

    def _start(self, clock_us: int) -> None:
        self._booted_ns = time.monotonic_ns() - 1000 * clock_us
        self._count = 0
        self._scan = None

    def _us(self, monotonic_ns: int) -> int:
        return (monotonic_ns - self._booted_ns) // 1000 % 2**32

    def _telegram(self, ranges_m: Array, told_ns: int, sent_ns: int) -> ScanData:
        model = self.model
        starting = (1, 0) if self._count <= _STARTING_SCANS else (0, 0)
        seconds, microsecond = divmod((sent_ns - self._booted_ns) // 1000, 1_000_000)
        day, second = divmod(seconds, 86_400)
        date = DeviceTime(
            1970, 1, 1 + day % 31, second // 3600, second // 60 % 60, second % 60, microsecond
        )
        return ScanData(
            version=model.version,
            device_number=1,
            serial_number=model.serial_number,
            status=_STATUS.get(self.mode, starting),
            telegram_counter=self._count % 2**16,
            scan_counter=self._count % 2**16,
            start_up_us=self._us(told_ns),
            transmission_us=self._us(sent_ns),
            inputs=(0, 0),
            outputs=(0, 0),
            layer_angle=0,
            scan_frequency=model.scan_frequency,
            measurement_frequency=model.measurement_frequency,
            channels=self._channels(ranges_m) if len(ranges_m) else (),
            device_name=self.device_name,
            comment=self.comment,
            time=date if self.dated else None,
        )

    def _channels(self, ranges_m: Array) -> tuple[Channel, ...]:
        distances = self._channel("DIST1", 16, self._raw(ranges_m))
        if self.model.intensity_bits == 0:
            return (distances,)
        bits = self.model.intensity_bits
        bright: Words = np.full(len(ranges_m), 200 if bits == 8 else 10_000, dtype=np.uint16)
        return distances, self._channel("RSSI1", bits, bright * np.isfinite(ranges_m))

    def _channel(self, name: str, bits: Literal[8, 16], values: Words) -> Channel:
        return Channel(
            name=name,
            bits=bits,
            scale=self.model.scale if name == "DIST1" else 1.0,
            offset=0.0,
            start_angle=self.model.start_angle,
            angle_step=round(1e4 * self.model.step_deg),
            values=values,
        )

    def _raw(self, ranges_m: Array) -> Words:
        """Whole millimetres (times the scale); NaN: a code; inf: 0, as real ones say."""
        per_m = 1e3 / self.model.scale
        raw = np.clip(np.rint(per_m * np.nan_to_num(ranges_m, posinf=1.0)), _CODES, _LARGEST)
        raw[np.isnan(ranges_m)] = _DAZZLED
        raw[np.isposinf(ranges_m)] = per_m * self._no_return_m if self._no_return_m else 0
        return raw.astype(np.uint16)


def damaged(telegram: bytes, dialect: Dialect, seed: int) -> bytes:
    """A scan telegram as a line may spoil it: CoLa B a bit; CoLa A, which has no checksum, so that
    its structure breaks: a field lost, the end lost, a byte that is no text."""
    dice = random.Random(seed)
    if dialect is Dialect.B:
        spoilt = bytearray(telegram)
        spoilt[dice.randrange(len(spoilt))] ^= 1 << dice.randrange(8)
        return bytes(spoilt)
    kind = dice.randrange(3)
    if kind == 0:
        blanks = [match.start() for match in re.finditer(b" ", telegram)]
        n = dice.randrange(1, len(blanks) - 1)
        return telegram[: blanks[n]] + telegram[blanks[n + 1] :]
    if kind == 1:
        return telegram[: dice.randrange(len(telegram))]
    at = dice.randrange(1, len(telegram) - 1)
    return telegram[:at] + b"\x00" + telegram[at + 1 :]
