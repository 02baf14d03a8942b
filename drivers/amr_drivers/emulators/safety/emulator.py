"""The scanner on its ports, with the faults that real ones have."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Final, Self

from amr_drivers.emulators.safety.damage import cut, spoilt_answer, spoilt_datagrams
from amr_drivers.emulators.safety.device import Mode, SafetyDevice
from amr_drivers.emulators.safety.models import MICROSCAN3, NANOSCAN3, SafetyModel
from amr_drivers.emulators.tcp_server import Connection, DeviceServer
from amr_drivers.sick_safety.cola2 import Command, Frame, FrameReader, encode_frame
from amr_drivers.sick_safety.datagrams import fragments
from amr_drivers.sick_safety.settings import Settings
from amr_drivers.sick_safety.variables import CHANNELS, LATEST_TELEGRAM
from amr_slam.geometry import Array
from amr_slam.simulation import ScannerModel

_DATAGRAM: Final = 1460


@dataclass(slots=True)
class _Client:
    reader: FrameReader = field(default_factory=FrameReader)
    sessions: set[int] = field(default_factory=set)
    """Opened by it."""


class EmulatedSafety:
    """An :class:`amr_drivers.emulators.scanner.EmulatedScanner`; a context manager.

    Attributes may be set from any thread.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 0,
        model: SafetyModel = MICROSCAN3,
        *,
        enabled: frozenset[int] = frozenset((0,)),
    ) -> None:
        """``port`` 0 lets the system choose. ``enabled``: channels that the stored configuration
        switches on. Raises OSError when the port is taken."""
        self.silent = False
        self.firewalled = False
        """True: datagrams go nowhere, TCP works."""
        self._device = SafetyDevice(model, enabled)
        self._lock = threading.RLock()
        self._plugged = True
        self._cut_at: int | None = None
        self._damage: int | None = None
        self._speech: bytes | None = None
        self._datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._datagrams.setblocking(False)
            self._datagrams.bind((host, 0))
            self._server = DeviceServer(
                host, port, _Client,
                connected=self._greet, heard=self._hear, gone=self._forget,
            )  # fmt: skip
        except OSError:
            self._datagrams.close()
            raise

    @property
    def port(self) -> int:
        """Where it listens for CoLa 2."""
        return self._server.port

    @property
    def model(self) -> SafetyModel:
        """Which scanner this is."""
        return self._device.model

    @property
    def sessions(self) -> int:
        """Open now."""
        with self._lock:
            return len(self._device.sessions)

    @property
    def streams(self) -> dict[int, int]:
        """Channel to the UDP port that its data are sent to."""
        with self._lock:
            return {channel: stream.port for channel, stream in self._device.streams.items()}

    @property
    def mode(self) -> Mode:
        """What the device knows of: it measures, with a screen more or less clean, or not."""
        return self._device.mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self._device.mode = mode

    @property
    def frozen(self) -> bool:
        """True: the same scan with the same counters again and again."""
        return self._device.frozen

    @frozen.setter
    def frozen(self, frozen: bool) -> None:
        self._device.frozen = frozen

    def configure(self, *, enabled: frozenset[int], big_endian_errors: bool = False) -> None:
        """Which channels are switched on, and how errors are sent."""
        with self._lock:
            self._device.enabled = enabled
            self._device.big_endian_errors = big_endian_errors

    def end_sessions(self) -> None:
        """All have been idle for too long."""
        with self._lock:
            self._device.sessions.clear()

    @property
    def optics(self) -> ScannerModel:
        """See :class:`amr_drivers.emulators.scanner.StandIn`."""
        derived = self._device.model.derived
        return ScannerModel(
            beams=derived.beams,
            # 90 degrees of these telegrams are straight ahead.
            angle_min_rad=math.radians(derived.start_deg - 90.0),
            angle_step_rad=math.radians(derived.step_deg),
            range_max_m=40.0,
            quantum_m=0.001,
            sweep_s=1e-6 * derived.interbeam_us * (derived.beams - 1),
        )

    def measure(self, ranges_m: Array) -> int:
        """A sweep has just ended with these ranges: (beams,) m, inf no return, NaN not measured.

        Returns the monotonic ns of its first beam.
        """
        with self._lock:
            first_ns = self._device.measure(ranges_m)
            self._device.expire()
            if self.silent or not self._plugged or self._speech is not None:
                return first_ns
            for stream, identification in self._device.due():
                instance = self._device.instance(stream.channel)
                datagrams = fragments(instance, identification, _DATAGRAM)
                if self._damage is not None:
                    datagrams, self._damage = spoilt_datagrams(datagrams, self._damage), None
                if self._cut_at is not None:
                    datagrams, self._cut_at = cut(datagrams, self._cut_at), None
                for datagram in datagrams:
                    self._send(datagram, (stream.receiver, stream.port))
        return first_ns

    def cut_next(self, at_byte: int) -> None:
        """Of the next scan only so many bytes leave; over TCP the device hangs up then."""
        with self._lock:
            self._cut_at = at_byte

    def damage_next(self, seed: int) -> None:
        """The next scan is spoilt (:mod:`amr_drivers.emulators.safety.damage`)."""
        with self._lock:
            self._damage = seed

    def send_bytes(self, data: bytes) -> None:
        """Noise to all who are listening: on TCP connections, or in datagrams."""
        with self._lock:
            streams = list(self._device.streams.values()) if self._plugged else []
        for stream in streams:
            for start in range(0, len(data), _DATAGRAM):
                noise = data[start : start + _DATAGRAM]
                self._send(noise, (stream.receiver, stream.port))
        for connection in self._server.connections():
            connection.send(data)

    def unplug(self) -> None:
        """Connections are cut and new ones refused; datagrams get lost."""
        self._plugged = False
        self._server.unplug()

    def replug(self) -> None:
        """And back, on the same port; the stream goes on by itself."""
        self._server.plug()
        self._plugged = True

    def power_cycle(self) -> None:
        """Counters, sessions and streams start anew; connections die."""
        with self._lock:
            self._device.power_cycle()
        self._server.cut_all()

    def be_another_device(self, speech: bytes) -> None:
        """From now on something else answers: ``speech`` on connecting and to every request."""
        with self._lock:
            self._speech = speech

    def close(self) -> None:
        """Idempotent."""
        self._server.close()
        self._datagrams.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _send(self, datagram: bytes, receiver: tuple[str, int]) -> None:
        if not self.firewalled:
            with contextlib.suppress(OSError):  # nobody listens, or nobody reads
                self._datagrams.sendto(datagram, receiver)

    def _greet(self, connection: Connection[_Client]) -> None:
        if self._speech is not None and not self.silent:
            connection.send(self._speech)

    def _forget(self, connection: Connection[_Client]) -> None:
        with self._lock:
            for session in connection.held.sessions:
                self._device.sessions.pop(session, None)

    def _hear(self, connection: Connection[_Client], data: bytes) -> None:
        questions = connection.held.reader.feed(data)
        if self.silent:
            return
        if self._speech is not None:
            connection.send(self._speech)
            return
        for question in questions:
            with self._lock:
                answer = self._device.answer(question)
                if answer.command == Command.OPENED:
                    connection.held.sessions.add(answer.session)
                spoilt = self._spoilt(answer)
            if spoilt is None:
                connection.send(encode_frame(answer))
                continue
            raw, hang_up = spoilt
            connection.send(raw)
            if hang_up:
                self._server.cut(connection)
                return

    def _spoilt(self, answer: Frame) -> tuple[bytes, bool] | None:
        """What leaves instead of a scan that suffers, and whether the device hangs up then."""
        index = answer.index or 0
        is_scan = LATEST_TELEGRAM <= index < LATEST_TELEGRAM + CHANNELS
        if answer.command != Command.VALUE or not is_scan:
            return None
        if self._cut_at is not None:
            raw, self._cut_at = encode_frame(answer)[: self._cut_at], None
            return raw, True
        if self._damage is not None:
            raw, self._damage = spoilt_answer(answer, self._damage), None
            return raw, False
        return None


def emulate(settings: Settings, model: SafetyModel | None = None) -> EmulatedSafety:
    """The scanner that these settings name, on its host and port.

    ``model`` None: a microScan3 to be polled, a nanoScan3 to stream.
    """
    if model is None:
        model = MICROSCAN3 if settings.mode == "poll" else NANOSCAN3
    if settings.serial_number:
        model = replace(model, serial_number=settings.serial_number)
    enabled = frozenset((settings.channel,))
    return EmulatedSafety(settings.host, settings.port, model, enabled=enabled)
