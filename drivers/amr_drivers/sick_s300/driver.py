"""SICK S300 and S3000 over a serial line, in continuous mode or in request mode."""

from __future__ import annotations

import threading
import time

from amr_drivers.background import BackgroundScanner
from amr_drivers.errors import LinkLost
from amr_drivers.sick_s300.decoder import ContinuousDecoder
from amr_drivers.sick_s300.request_decoder import RequestDecoder
from amr_drivers.sick_s300.requests import Command, Request, encode_request
from amr_drivers.sick_s300.settings import Settings
from amr_drivers.transport import ByteStream
from amr_slam.samples import DeviceInfo, Tap, untapped

__all__ = ["S300", "Settings", "open_scanner", "scan_decoder"]

_SLICE_S = 0.1
"""Longest wait of one turn."""
_AFTER_REFUSAL_S = 0.1
"""A scanner that refuses is not asked again at once."""
_FAREWELL_S = 0.2
"""What the listening thread may take to release the token."""
_DEAD_S = 2.0
"""A converter from which nothing came for so long may have lost the connection without telling."""


def open_scanner(name: str, settings: Settings, tap: Tap = untapped) -> S300:
    """Open the port and begin to listen, or to ask; does not wait for the first telegram.

    Raises LinkLost or LinkTimeout when the port cannot be opened, ValueError for a port that
    can never be one.
    """
    if settings.mode == "continuous":
        return _ContinuousS300(name, settings, tap)
    return _AskedS300(name, settings, tap)


def scan_decoder(
    name: str, settings: Settings, start_ns: int
) -> ContinuousDecoder | RequestDecoder:
    """What turns recorded bytes of this scanner into scans."""
    if settings.mode == "continuous":
        return ContinuousDecoder(name, settings, start_ns)
    return RequestDecoder(name, settings, start_ns)


class S300(BackgroundScanner):
    """A :class:`amr_slam.samples.Scanner`."""

    def __init__(
        self, name: str, settings: Settings, tap: Tap, decoder: ContinuousDecoder | RequestDecoder
    ) -> None:
        super().__init__(name, decoder, tap)
        self._settings = settings
        self._s300 = decoder
        self._stream = ByteStream(settings.port, settings.baud_rate)
        self._back_ns = self._heard_ns = time.monotonic_ns()
        self._start()

    def info(self) -> DeviceInfo:
        settings = self._settings
        facts = (
            ("mode", settings.mode),
            ("baud rate", str(settings.baud_rate)),
            ("beams", str(settings.beams)),
            ("field of view", f"{settings.field_of_view_deg:g} deg"),
            ("device address", settings.device_address),
            *self._s300.facts(),
        )
        return DeviceInfo(model="SICK S300/S3000", address=settings.port, facts=facts)

    def _turn(self) -> None:
        data = self._stream.read(0.0)
        now_ns = time.monotonic_ns()
        # A read lasts 0.1 s at most. Who was away for longer finds bytes of unknown age.
        if now_ns - self._back_ns > 1e9 * (_SLICE_S + self._settings.latency_limit_s):
            self._drop_input()
        elif data:
            self._take(data, now_ns)
        if data:
            self._heard_ns = now_ns
        self._refuse_dead_connection(now_ns)
        self._back_ns = time.monotonic_ns()

    def _drop_input(self) -> None:
        self._stream.discard_input()
        self._note_gap()

    def _refuse_dead_connection(self, now_ns: int) -> None:
        """Nothing tells of a converter that was switched off; a new connection does."""
        silent_s = 1e-9 * (now_ns - self._heard_ns)
        is_converter = "://" in self._settings.port
        if is_converter and silent_s > max(_DEAD_S, 2.0 * self._s300.silence_s):
            raise LinkLost(f"{self._settings.port}: nothing came for {silent_s:.1f} s")

    def _hang_up(self) -> None:
        self._stream.close()

    def _max_age_s(self) -> float:
        return self._s300.max_age_s


class _ContinuousS300(S300):
    """Listens to a scanner that sends by itself."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        decoder = ContinuousDecoder(name, settings, time.monotonic_ns())
        super().__init__(name, settings, tap, decoder)


class _AskedS300(S300):
    """Asks a scanner for each scan: takes the token, fetches, and releases it in the end."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        self._closing = threading.Event()
        self._asked_ns = self._fetched_ns = 0
        self._requests = RequestDecoder(name, settings, time.monotonic_ns())
        super().__init__(name, settings, tap, self._requests)

    def _turn(self) -> None:
        if self._closing.is_set():
            self._take_leave()
        elif self._requests.waits:
            super()._turn()
            if self._requests.waits and time.monotonic_ns() > self._requests.deadline_ns:
                self._send(self._requests.dialogue.next_request)
        elif (left_s := self._pause_s()) > 0.0:
            # Nothing is read: whatever comes now is no answer.
            self._closing.wait(min(left_s, _SLICE_S))
        else:
            self._send(self._requests.dialogue.next_request)

    def _pause_s(self) -> float:
        """Until the next request is due."""
        due_ns = self._asked_ns
        if self._requests.dialogue.next_request.command is Command.FETCH:
            due_ns = self._fetched_ns + round(1e9 * self._settings.poll_interval_s)
        if self._requests.refused:
            due_ns = max(due_ns, self._asked_ns + round(1e9 * _AFTER_REFUSAL_S))
        return 1e-9 * (due_ns - time.monotonic_ns())

    def _send(self, request: Request) -> None:
        data = encode_request(request)
        self._stream.discard_input()
        self._stream.write(data)
        self._asked_ns = self._back_ns = time.monotonic_ns()
        if request.command is Command.FETCH:
            self._fetched_ns = self._asked_ns
        self._note_sent(data)

    def _take_leave(self) -> None:
        farewell = self._requests.dialogue.farewell
        if farewell is not None:
            self._send(farewell)
        raise LinkLost(f"{self._settings.port}: closed")

    def _hang_up(self) -> None:
        self._closing.set()
        # The thread releases the token. One that hangs in a dead line is not waited for.
        if self._thread.is_alive():
            self._thread.join(_FAREWELL_S)
        super()._hang_up()
