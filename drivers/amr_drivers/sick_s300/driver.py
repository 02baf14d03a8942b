"""SICK S300 and S3000 over a serial line, in continuous mode."""

from __future__ import annotations

import time

from amr_drivers.background import BackgroundScanner
from amr_drivers.sick_s300.decoder import ContinuousDecoder
from amr_drivers.sick_s300.settings import Settings
from amr_drivers.transport import ByteStream
from amr_slam.samples import DeviceInfo, Tap, untapped

__all__ = ["S300", "Settings", "open_scanner", "scan_decoder"]


def open_scanner(name: str, settings: Settings, tap: Tap = untapped) -> S300:
    """Open the port and begin to listen; does not wait for the first telegram.

    Raises LinkLost or LinkTimeout when the port cannot be opened.
    """
    return S300(name, settings, tap)


def scan_decoder(name: str, settings: Settings, start_ns: int) -> ContinuousDecoder:
    """What turns recorded bytes of this scanner into scans."""
    return ContinuousDecoder(name, settings, start_ns)


class S300(BackgroundScanner):
    """A :class:`amr_slam.samples.Scanner`."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        self._settings = settings
        self._continuous = scan_decoder(name, settings, time.monotonic_ns())
        super().__init__(name, self._continuous, tap)
        self._stream = ByteStream(settings.port, settings.baud_rate)
        self._back_ns = time.monotonic_ns()
        self._start()

    def info(self) -> DeviceInfo:
        settings = self._settings
        facts = (
            ("baud rate", str(settings.baud_rate)),
            ("beams", str(settings.beams)),
            ("field of view", f"{settings.field_of_view_deg:g} deg"),
            ("device address", settings.device_address),
            *self._continuous.facts(),
        )
        return DeviceInfo(model="SICK S300/S3000", address=settings.port, facts=facts)

    def _turn(self) -> None:
        data = self._stream.read(0.0)
        now_ns = time.monotonic_ns()
        # A read lasts 0.1 s at most. Who was away for longer finds bytes of unknown age.
        if now_ns - self._back_ns > 1e8 + 1e9 * self._settings.latency_limit_s:
            self._stream.discard_input()
            self._note_gap()
        elif data:
            self._take(data, now_ns)
        self._back_ns = time.monotonic_ns()

    def _hang_up(self) -> None:
        self._stream.close()

    def _max_age_s(self) -> float:
        return self._settings.sweep_s + self._continuous.silence_s
