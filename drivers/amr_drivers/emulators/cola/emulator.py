"""The scanner on its port, with the faults that real ones have."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Literal, Self

from amr_drivers.emulators.cola.device import ColaDevice, Mode, damaged
from amr_drivers.emulators.cola.models import LMS111, MODELS, ColaModel
from amr_drivers.emulators.tcp_server import Connection, DeviceServer
from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.framing import ColaAReader, ColaBReader, Dialect, Frame, FrameReader
from amr_drivers.sick_cola.messages import SCAN, Message, parse_message
from amr_drivers.sick_cola.settings import Settings
from amr_slam.geometry import Array
from amr_slam.simulation import ScannerModel


@dataclass(slots=True)
class _Client:
    readers: dict[Dialect, FrameReader] = field(
        default_factory=lambda: {Dialect.A: ColaAReader(), Dialect.B: ColaBReader()}
    )
    mute: bool = False
    """The wrong dialect was heard: nothing is answered any more."""
    subscribed: bool = False


class EmulatedCola:
    """An :class:`amr_drivers.emulators.scanner.EmulatedScanner`; a context manager.

    Attributes may be set from any thread.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 0,
        model: ColaModel = LMS111,
        dialect: Dialect = Dialect.B,
        *,
        started_us: int = 2**32 - 5_000_000,
        mute_after_wrong_dialect: bool = False,
        no_return_m: float | None = None,
    ) -> None:
        """``port`` 0 lets the system choose. ``started_us``: the device's clock at first, 5 s
        before it wraps. ``no_return_m``: what "nothing there" is sent as; None: as 0, as real
        ones do. Raises OSError when the port is taken."""
        self.silent = False
        self.repeated = 0
        """So often each streamed telegram is sent once more."""
        self._device = ColaDevice(model, dialect, started_us=started_us, no_return_m=no_return_m)
        self._mute = mute_after_wrong_dialect
        self._lock = threading.RLock()
        self._cut_at: int | None = None
        self._damage: int | None = None
        self._speech: bytes | None = None
        self._server = DeviceServer(host, port, _Client, connected=self._greet, heard=self._hear)

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    @property
    def model(self) -> ColaModel:
        """Which scanner this is."""
        return self._device.model

    @property
    def mode(self) -> Mode:
        """What the device knows of: it measures, with a screen more or less clean, or not."""
        return self._device.mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self._device.mode = mode

    @property
    def frozen(self) -> bool:
        """True: the same scan with the same counter again and again."""
        return self._device.frozen

    @frozen.setter
    def frozen(self, frozen: bool) -> None:
        self._device.frozen = frozen

    def describe(self, *, name: str | None, comment: str | None, dated: bool) -> None:
        """Which of the optional blocks the telegrams carry."""
        with self._lock:
            device = self._device
            device.device_name, device.comment, device.dated = name, comment, dated

    @property
    def optics(self) -> ScannerModel:
        """See :class:`amr_drivers.emulators.scanner.StandIn`."""
        model = self._device.model
        return ScannerModel(
            beams=model.beams,
            # 90 degrees of these telegrams are straight ahead.
            angle_min_rad=math.radians(1e-4 * model.start_angle - 90.0),
            angle_step_rad=math.radians(model.step_deg),
            range_max_m=model.range_max_m,
            quantum_m=0.001 * model.scale,
            sweep_s=model.sweep_s,
        )

    def measure(self, ranges_m: Array) -> int:
        """A sweep has just ended with these ranges: (beams,) m, inf no return, NaN not measured.

        Returns the monotonic ns of its first beam.
        """
        with self._lock:
            first_ns = self._device.measure(ranges_m)
            if self._device.mode == "standby" or self._speech is not None or self.silent:
                return first_ns
            clients = [c for c in self._server.connections() if c.held.subscribed]
            for connection in clients:
                self._send_scan(connection, "sSN")
        return first_ns

    def cut_next(self, at_byte: int) -> None:
        """Of the next scan telegram only so many bytes leave, then the device hangs up."""
        with self._lock:
            self._cut_at = at_byte

    def damage_next(self, seed: int) -> None:
        """The next scan telegram is spoilt (:func:`amr_drivers.emulators.cola.device.damaged`)."""
        with self._lock:
            self._damage = seed

    def send_bytes(self, data: bytes) -> None:
        """Noise on the line."""
        for connection in self._server.connections():
            connection.send(data)

    def unplug(self) -> None:
        """Connections are cut and new ones refused."""
        self._server.unplug()

    def replug(self) -> None:
        """And back, on the same port."""
        self._server.plug()

    def power_cycle(self) -> None:
        """Counters, clock and subscriptions start anew; connections die."""
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _greet(self, connection: Connection[_Client]) -> None:
        if self._speech is not None and not self.silent:
            connection.send(self._speech)

    def _hear(self, connection: Connection[_Client], data: bytes) -> None:
        with self._lock:
            if self.silent:
                return
            if self._speech is not None:
                connection.send(self._speech)
                return
            for dialect, reader in connection.held.readers.items():
                for frame in reader.feed(data):
                    if dialect is self._device.dialect:
                        self._serve(connection, frame)
                    elif self._mute:
                        connection.held.mute = True

    def _serve(self, connection: Connection[_Client], frame: Frame) -> None:
        if connection.held.mute:
            return
        try:
            request = parse_message(frame.payload, frame.dialect)
            if not isinstance(request, Message):
                return
            subscription = self._device.subscription(request)
        except BadTelegram:
            return
        if (request.word, request.name) == ("sRN", SCAN):
            self._send_scan(connection, "sRA")
            return
        connection.send(self._device.answer(request))
        if subscription is not None:
            connection.held.subscribed = subscription

    def _send_scan(self, connection: Connection[_Client], word: Literal["sRA", "sSN"]) -> None:
        telegram = self._device.scan(word)
        if self._damage is not None:
            telegram, self._damage = damaged(telegram, self._device.dialect, self._damage), None
        if self._cut_at is not None:
            connection.send(telegram[: self._cut_at])
            self._cut_at = None
            self._server.cut(connection)
            return
        for _ in range(1 + (self.repeated if word == "sSN" else 0)):
            connection.send(telegram)


def emulate(settings: Settings, model: ColaModel | None = None) -> EmulatedCola:
    """The scanner that these settings name, on its host and port.

    ``model`` None: the one with the range that the settings have, LMS111 where none has. It speaks
    CoLa B where the settings leave the dialect open.
    """
    if model is None:
        of_range = [m for m in MODELS.values() if m.range_max_m == settings.range_max_m]
        model = (*of_range, LMS111)[0]
    if settings.serial_number:
        model = replace(model, serial_number=settings.serial_number)
    dialect = Dialect.A if settings.dialect == "a" else Dialect.B
    return EmulatedCola(settings.host, settings.port, model, dialect)
