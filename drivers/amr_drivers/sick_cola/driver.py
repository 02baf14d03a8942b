"""SICK LMS1xx, LMS5xx, TiM5xx and TiM7xx over TCP."""

from __future__ import annotations

import contextlib
import threading
import time

from amr_drivers.background import BackgroundScanner
from amr_drivers.errors import DriverError, LinkLost
from amr_drivers.sick_cola.decoder import ColaDecoder
from amr_drivers.sick_cola.dialogue import Dialogue, Step
from amr_drivers.sick_cola.settings import Settings
from amr_drivers.transport import TcpStream
from amr_slam.samples import DeviceInfo, RawBytes, Tap, Way, untapped

__all__ = ["Cola", "Settings", "open_scanner", "scan_decoder"]

_SLICE_S = 0.02
"""Longest wait between two looks at the dialogue."""
_CONNECT_S = 0.3
"""For one connection made anew: ``close`` waits for it."""
_RECONNECTING_S = 5.0
"""For how long a device may refuse a new connection after the wrong dialect."""


def open_scanner(name: str, settings: Settings, tap: Tap = untapped) -> Cola:
    """Connect and begin to listen; does not wait for the first telegram.

    Raises LinkLost or LinkTimeout when nobody answers at the address.
    """
    return Cola(name, settings, tap)


def scan_decoder(name: str, settings: Settings, start_ns: int) -> ColaDecoder:
    """What turns recorded bytes of this scanner into scans."""
    return ColaDecoder(name, settings, start_ns)


class Cola(BackgroundScanner):
    """A :class:`amr_slam.samples.Scanner`."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        now_ns = time.monotonic_ns()
        self._settings = settings
        self._cola = scan_decoder(name, settings, now_ns)
        super().__init__(name, self._cola, tap)
        self._dialogue = Dialogue(settings, self._cola, now_ns)
        self._closing = threading.Event()
        self._stream = TcpStream(settings.host, settings.port)
        self._start()

    def info(self) -> DeviceInfo:
        settings = self._settings
        return DeviceInfo(
            model=f"SICK {self._cola.model or 'LMS/TiM'}",
            address=f"{settings.host}:{settings.port}",
            facts=(("delivery", settings.delivery), *self._cola.facts()),
        )

    def close(self) -> None:
        """Idempotent."""
        super().close()
        self._stream.close()

    def _turn(self) -> None:
        if self._closing.is_set():
            self._say_goodbye()
            raise LinkLost("closed")
        if data := self._stream.read(_SLICE_S):
            self._digest(data, time.monotonic_ns())
        step = self._dialogue.next(time.monotonic_ns())
        if isinstance(step, bytes):
            self._stream.write(step)
            self._note_sent(step)
        elif step is Step.RECONNECT:
            self._reconnect()

    def _digest(self, data: bytes, stamp_ns: int) -> None:
        if self._dialogue.warming_up:
            # The age of these scans is not known yet: they teach the clock only.
            raw = RawBytes(device=self._name, stamp_ns=stamp_ns, way=Way.RECEIVED, data=data)
            self._tap(raw)
            self._decoder.received(data, stamp_ns)
        else:
            self._take(data, stamp_ns)

    def _reconnect(self) -> None:
        self._stream.close()
        self._note_gap()
        deadline = time.monotonic() + _RECONNECTING_S
        while True:
            try:
                self._stream = TcpStream(self._settings.host, self._settings.port, _CONNECT_S)
            except DriverError:
                if time.monotonic() > deadline or self._closing.wait(0.2):
                    raise
            else:
                break
        self._dialogue.connected(time.monotonic_ns())

    def _say_goodbye(self) -> None:
        if self._dialogue.streaming:
            with contextlib.suppress(DriverError):
                self._stream.write(stop := self._dialogue.stop())
                self._note_sent(stop)

    def _hang_up(self) -> None:
        self._closing.set()

    def _max_age_s(self) -> float:
        return max(self._cola.silence_s, 2.5 * self._cola.period_s)
