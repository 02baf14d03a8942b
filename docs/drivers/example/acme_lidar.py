"""A driver to copy: the ACME datagram scanner, which does not exist.

It sends each sweep unasked, in one UDP datagram: counter, 1 or 0 for standby, ranges in m (inf no
return, NaN not measured), CRC-32.
"""

from __future__ import annotations

import struct
import time
import zlib
from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

from amr_drivers.background import BackgroundScanner
from amr_drivers.timing import ArrivalClock
from amr_drivers.transport import DatagramPort
from amr_slam.geometry import Array
from amr_slam.samples import DeviceInfo, Scan, Tap, untapped

BEAMS: Final = 271
SWEEP_S: Final = 0.03
SILENCE_S: Final = 0.4
BODY: Final = struct.Struct(f"<I?{4 * BEAMS}s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Where the scanner sends to."""

    port: int = 4711
    """UDP port of this computer."""


class Decoder:
    """An :class:`amr_drivers.background.ScanDecoder`: no socket, no clock."""

    def __init__(self, name: str, start_ns: int) -> None:
        self._name, self._heard_ns = name, start_ns
        self._clock = ArrivalClock(latency_limit_ns=100_000_000)
        self._damaged, self._counter = 0, -1
        self._hindrance: str | None = None

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        parsed = _parse(data)
        if parsed is None:
            self._damaged += 1
            return []
        counter, measuring, ranges_m = parsed
        frozen = "frozen: the counter stands still" if counter == self._counter else None
        self._hindrance = frozen if measuring else "standby"
        self._counter, self._heard_ns = counter, stamp_ns
        # None: waited somewhere for longer than lines and schedulers take, so it is old.
        sent_ns = None if self._hindrance else self._clock.refine(counter, stamp_ns)
        if sent_ns is None:
            return []
        scan = Scan(
            scanner=self._name,
            stamp_ns=sent_ns - round(1e9 * SWEEP_S),
            ranges_m=ranges_m,
            angle_min_rad=radians(-135.0),
            angle_step_rad=radians(1.0),
            sweep_s=SWEEP_S,
            seq=counter,
        )
        return [scan]

    def sent(self, data: bytes, stamp_ns: int) -> None:
        """Nothing is ever sent to this scanner."""

    def gap(self) -> None:
        """Each datagram is whole by itself."""

    def status(self, now_ns: int) -> tuple[int, str | None]:
        silent_s = 1e-9 * (now_ns - self._heard_ns)
        silent = f"no scan for {silent_s:.1f} s" if silent_s > SILENCE_S else None
        return self._damaged, silent or self._hindrance


def _parse(data: bytes) -> tuple[int, bool, Array] | None:
    """Counter, measuring, (BEAMS,) ranges in m; None for what is no datagram of this scanner."""
    body, checksum = data[: BODY.size], data[BODY.size :]
    if checksum != zlib.crc32(body).to_bytes(4, "little"):
        return None
    counter, measuring, ranges = BODY.unpack(body)
    return counter, measuring, np.frombuffer(ranges, "<f4").astype(np.float64)


class Lidar(BackgroundScanner):
    """A :class:`amr_slam.samples.Scanner`; BackgroundScanner does the reading."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        super().__init__(name, Decoder(name, time.monotonic_ns()), tap)
        self._datagrams = DatagramPort("", settings.port)
        self._start()

    def info(self) -> DeviceInfo:
        return DeviceInfo(model="ACME datagram scanner", address=f"udp {self._datagrams.port}")

    def _turn(self) -> None:
        if data := self._datagrams.read(0.1):
            self._take(data, time.monotonic_ns())

    def _hang_up(self) -> None:
        self._datagrams.close()

    def _max_age_s(self) -> float:
        return SWEEP_S + SILENCE_S


def open_scanner(name: str, settings: Settings, tap: Tap = untapped) -> Lidar:
    """Begin to listen. Raises LinkLost when the port is taken."""
    return Lidar(name, settings, tap)


def scan_decoder(name: str, settings: Settings, start_ns: int) -> Decoder:  # noqa: ARG001 - contract
    """What turns recorded bytes of this scanner into scans."""
    return Decoder(name, start_ns)
