"""A driver to copy: the ACME text-line scanner, which does not exist.

It sends a line a sweep over TCP, unasked: ``SCAN <counter> <OK|STANDBY> <mm> <mm> ...*<CRC-32>``.
A range is whole millimetres, ``inf`` (no return) or ``nan`` (not measured).
"""

from __future__ import annotations

import re
import time
import zlib
from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

from amr_drivers.background import BackgroundScanner
from amr_drivers.errors import LinkLost
from amr_drivers.timing import ArrivalClock
from amr_drivers.transport import TcpStream
from amr_slam.geometry import Array
from amr_slam.samples import DeviceInfo, Scan, Tap, untapped

BEAMS: Final = 271
SWEEP_S: Final = 0.03
SILENCE_S: Final = 0.5
_MAX_LINE: Final = 4096
_RANGE: Final = rb"(?:\d{1,5}|inf|nan)"
_LINE: Final = re.compile(
    rb"(SCAN (\d{1,9}) (OK|STANDBY) (%b(?: %b){%d}))\*([0-9a-f]{8})" % (_RANGE, _RANGE, BEAMS - 1)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Where the scanner is."""

    host: str
    """Name or address."""
    port: int = 4711
    """TCP port."""


class Decoder:
    """An :class:`amr_drivers.background.ScanDecoder`: no socket, no clock."""

    def __init__(self, name: str, start_ns: int) -> None:
        self._name, self._heard_ns = name, start_ns
        self._clock = ArrivalClock(latency_limit_ns=100_000_000)
        self._rest, self._begun_ns = b"", start_ns
        self._damaged, self._counter = 0, -1
        self._hindrance: str | None = None

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        # A line is as old as its first byte.
        begun_ns = self._begun_ns if self._rest else stamp_ns
        *lines, rest = (self._rest + data).split(b"\n")
        scans: list[Scan] = []
        for line in lines:
            scans += self._scan(line, begun_ns, stamp_ns)
            begun_ns = stamp_ns
        self._rest, self._begun_ns = rest[:_MAX_LINE], begun_ns
        return scans

    def sent(self, data: bytes, stamp_ns: int) -> None:
        """Nothing is ever sent to this scanner."""

    def gap(self) -> None:
        self._rest = b""

    def status(self, now_ns: int) -> tuple[int, str | None]:
        silent_s = self.silent_s(now_ns)
        silent = f"no scan for {silent_s:.1f} s" if silent_s > SILENCE_S else None
        return self._damaged, silent or self._hindrance

    def silent_s(self, now_ns: int) -> float:
        """Since the last line that was understood, scan or not."""
        return 1e-9 * (now_ns - self._heard_ns)

    def _scan(self, line: bytes, begun_ns: int, stamp_ns: int) -> list[Scan]:
        parsed = _parse(line)
        if parsed is None:
            self._damaged += 1
            return []
        counter, state, ranges_m = parsed
        frozen = "frozen: the counter stands still" if counter == self._counter else None
        self._hindrance = frozen if state == b"OK" else "standby"
        self._counter, self._heard_ns = counter, stamp_ns
        # None: waited somewhere for longer than lines and schedulers take, so it is old.
        first_ns = None if self._hindrance else self._clock.refine(counter, begun_ns)
        if first_ns is None:
            return []
        scan = Scan(
            scanner=self._name,
            stamp_ns=first_ns - round(1e9 * SWEEP_S),
            ranges_m=ranges_m,
            angle_min_rad=radians(-135.0),
            angle_step_rad=radians(1.0),
            sweep_s=SWEEP_S,
            seq=counter,
        )
        return [scan]


def _parse(line: bytes) -> tuple[int, bytes, Array] | None:
    """Counter, state and (BEAMS,) ranges in m; None for what is no line of this scanner."""
    match = _LINE.fullmatch(line)
    if match is None or zlib.crc32(match[1]) != int(match[5], 16):
        return None
    return int(match[2]), match[3], 1e-3 * np.array(match[4].split(), dtype=np.float64)


class Lidar(BackgroundScanner):
    """A :class:`amr_slam.samples.Scanner`; BackgroundScanner does the reading."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        self._address = f"{settings.host}:{settings.port}"
        self._lines = Decoder(name, time.monotonic_ns())
        super().__init__(name, self._lines, tap)
        self._stream = TcpStream(settings.host, settings.port)
        self._start()

    def info(self) -> DeviceInfo:
        return DeviceInfo(model="ACME text-line scanner", address=self._address)

    def _turn(self) -> None:
        data = self._stream.read(0.1)
        now_ns = time.monotonic_ns()
        if data:
            self._take(data, now_ns)
        # A pulled cable sends no farewell: only time tells.
        if self._lines.silent_s(now_ns) > SILENCE_S:
            raise LinkLost(f"{self._address}: no scan for {SILENCE_S:g} s")

    def _hang_up(self) -> None:
        self._stream.close()

    def _max_age_s(self) -> float:
        return SWEEP_S + SILENCE_S


def open_scanner(name: str, settings: Settings, tap: Tap = untapped) -> Lidar:
    """Connect and begin to listen. Raises LinkLost or LinkTimeout when it is not there."""
    return Lidar(name, settings, tap)


def scan_decoder(name: str, settings: Settings, start_ns: int) -> Decoder:  # noqa: ARG001 - contract
    """What turns recorded bytes of this scanner into scans."""
    return Decoder(name, start_ns)
