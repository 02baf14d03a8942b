"""A scanner that sends each scan over UDP."""

from __future__ import annotations

import threading
import time
from typing import Final

from amr_drivers.background import BackgroundScanner
from amr_drivers.errors import DriverError, LinkLost
from amr_drivers.sick_safety.decoder import StreamedDecoder
from amr_drivers.sick_safety.identity import Identity, read_identity
from amr_drivers.sick_safety.session import Session
from amr_drivers.sick_safety.settings import Settings
from amr_drivers.sick_safety.variables import CHANGE_STREAM, Stream, encode_stream, interface_of
from amr_drivers.transport import DatagramPort, TcpStream
from amr_slam.samples import DeviceInfo, Tap

_IDLE_S: Final = 60
_SLICE_S: Final = 0.05
_TURN_S: Final = 0.1
_CONNECT_S: Final = 0.3
"""For a connection made while listening: ``close`` waits for it."""
_AGAIN_S: Final = 1.0
"""The stream of a silent scanner is switched on anew after so long, then after twice that..."""
_SELDOM_S: Final = 8.0
"""...up to this: each access over TCP may itself disturb a stream."""


class Streamed(BackgroundScanner):
    """A :class:`amr_slam.samples.Scanner`."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        now_ns = time.monotonic_ns()
        self._settings = settings
        self._streaming = StreamedDecoder(name, settings, now_ns)
        super().__init__(name, self._streaming, tap)
        self._address = f"{settings.host}:{settings.port}"
        self._stopping = threading.Event()
        self._identity: Identity | None = None
        self._told: str | None = None
        self._switched_on_ns = now_ns
        self._pause_s = _AGAIN_S
        self._back_ns = now_ns
        self._stream: TcpStream | None = TcpStream(settings.host, settings.port)
        try:
            self._datagrams = DatagramPort("", settings.udp_port, sender=settings.host)
        except DriverError:
            self._stream.close()
            raise
        self._start()

    def info(self) -> DeviceInfo:
        identity = self._identity or Identity()
        facts = (
            ("mode", "stream"),
            ("UDP port", str(self._datagrams.port)),
            *identity.facts,
            *self._streaming.facts(),
        )
        return DeviceInfo(model=identity.model, address=self._address, facts=facts)

    def status(self) -> tuple[int, str | None]:
        """See :class:`amr_slam.samples.Scanner`."""
        errors, hindrance = super().status()
        now_ns = time.monotonic_ns()
        silent_s, told = self._streaming.silent_s(now_ns), self._told
        answered = told is not None and 1e-9 * (now_ns - self._switched_on_ns) < silent_s
        if self._fault is not None or silent_s <= self._streaming.silence_s or not answered:
            return errors, hindrance
        foreign = self._datagrams.foreign
        others = f"; {foreign} datagrams came from other addresses" if foreign else ""
        return errors, (
            f"{hindrance}; TCP works and the scanner sends to {told}: is a firewall in between, "
            f"is that this computer, does another one use the channel?{others}"
        )

    def close(self) -> None:
        """Idempotent. The scanner goes on sending: to stop it would take too long."""
        super().close()
        self._datagrams.close()
        if self._stream is not None:
            self._stream.close()

    def _turn(self) -> None:
        if self._stopping.is_set():
            raise LinkLost(f"{self._address}: closed")
        if self._told is None or self._is_silent():
            self._switch_on()
        data = self._datagrams.read(_SLICE_S)
        now_ns = time.monotonic_ns()
        # A read lasts no longer. Who was away finds datagrams of unknown age.
        if now_ns - self._back_ns > 1e9 * (_TURN_S + self._settings.latency_limit_s):
            self._datagrams.discard_input()
            self._note_gap()
        elif data:
            self._take(data, now_ns)
        self._back_ns = time.monotonic_ns()

    def _is_silent(self) -> bool:
        now_ns = time.monotonic_ns()
        if self._streaming.silent_s(now_ns) <= self._streaming.silence_s:
            self._pause_s = _AGAIN_S
            return False
        return now_ns - self._switched_on_ns > 1e9 * self._pause_s

    def _switch_on(self) -> None:
        """Tell the scanner where to send. Raises DriverError: it does not answer, or refuses."""
        settings = self._settings
        if self._told is not None:
            self._pause_s = min(2.0 * self._pause_s, _SELDOM_S)
        stream = self._stream or TcpStream(settings.host, settings.port, _CONNECT_S)
        self._stream = stream
        session = Session(
            self._address, stream, answer_s=settings.silence_s, stopping=self._stopping
        )
        try:
            session.open(_IDLE_S)
            if self._identity is None:
                self._identity = read_identity(session)
            receiver = settings.receiver or stream.own_host
            session.call(CHANGE_STREAM, encode_stream(self._wanted(receiver)))
            self._told = f"{receiver}:{self._datagrams.port}"
        finally:
            session.close()
            stream.close()
            self._stream = None
        self._switched_on_ns = time.monotonic_ns()

    def _wanted(self, receiver: str) -> Stream:
        settings = self._settings
        type_code = "" if self._identity is None else self._identity.type_code
        return Stream(
            channel=settings.channel,
            enabled=True,
            interface=interface_of(type_code),
            receiver=receiver,
            port=self._datagrams.port,
            every_nth=settings.every_nth,
        )

    def _hang_up(self) -> None:
        self._stopping.set()

    def _max_age_s(self) -> float:
        return self._streaming.silence_s + _TURN_S
