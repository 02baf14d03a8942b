"""Wheel odometry from any bus that python-can knows. The only part that imports it."""

from __future__ import annotations

import contextlib
import threading
import time
from dataclasses import dataclass, field
from typing import Annotated, Any

import can
from annotated_types import Ge, Gt, Le
from can.interfaces.slcan import slcanBus

from amr_drivers.can_odometry.counting import Limits
from amr_drivers.can_odometry.frames import FrameDecoder, Signals, WheelSettings
from amr_drivers.can_odometry.recorded import RecordedWheels
from amr_drivers.errors import BadTelegram, LinkLost
from amr_slam.samples import WHEELS, DeviceInfo, RawFrame, Tap, WheelSample, untapped

_SLICE_S = 0.1
"""Longest single wait: what ``close`` from another thread may have to wait for."""
_MAX_TROUBLES = 100
"""Unreadable frames in a row after which the adapter is no adapter any more."""
_MAX_AGE_S = 10.0
"""A frame cannot have waited for longer: the sender's clock, not ours, has stamped it."""
_FLUSH_S = 1.0
_CLASS_OF_ERROR = ((0x40, "bus-off"), (0x20, "no acknowledgement"), (0x80, "bus errors"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The bus, the frames on it and the wheels' limits."""

    interface: str = "socketcan"
    """python-can's name: socketcan, slcan, udp_multicast, pcan, ..."""
    channel: str = "can0"
    """Network interface, serial port of an slcan adapter, multicast group."""
    bitrate: Annotated[int, Gt(0), Le(1_000_000)] = 500_000
    """For adapters that are told; a socketcan interface has its own from ``ip link``."""
    dbc: str
    """Path of the DBC file that describes the frames."""
    left: WheelSettings = field(default_factory=lambda: WheelSettings(signal="LeftCount"))
    """The left wheel, seen in driving direction."""
    right: WheelSettings = field(default_factory=lambda: WheelSettings(signal="RightCount"))
    """The right wheel."""
    sequence_signal: str = ""
    """Name of a frame counter in the wheels' frames, if there is one: tells repeated frames."""
    limits: Limits = field(default_factory=Limits)
    """Beyond them, a step is an encoder that started anew, not a motion."""
    silence_s: Annotated[float, Gt(0)] = 0.1
    """Without counts for so long, ``status`` says so: five periods at 50 Hz."""
    open_delay_s: Annotated[float, Ge(0), Le(10)] = 0.0
    """Wait after the port of an slcan adapter is opened: some boards restart then (2 s)."""


FILES = ("dbc",)
"""Settings that name files: a recording takes their contents along."""


def open_odometry(settings: Settings, tap: Tap = untapped) -> CanOdometry:
    """Open the bus and begin to listen; does not wait for the first frame.

    Raises LinkLost when the bus cannot be opened, ValueError for a DBC file that does not fit.
    """
    return CanOdometry(settings, tap)


def wheel_decoder(settings: Settings, _start_ns: int) -> RecordedWheels:
    """What turns recorded frames into samples. Raises ValueError as :func:`open_odometry`."""
    signals = Signals(settings.dbc, settings.left, settings.right, settings.sequence_signal)
    return RecordedWheels(FrameDecoder(signals, settings.limits))


class CanOdometry:
    """An :class:`amr_slam.samples.OdometrySource`."""

    def __init__(self, settings: Settings, tap: Tap = untapped) -> None:
        self._settings = settings
        self._tap = tap
        signals = Signals(settings.dbc, settings.left, settings.right, settings.sequence_signal)
        self._decoder = FrameDecoder(signals, settings.limits)
        self._errors = 0
        self._troubles = 0
        self._hindrance: str | None = None
        self._receiving = threading.Lock()
        self._closed = threading.Event()
        self._opened_ns = self._back_ns = self._flushed_ns = time.monotonic_ns()
        self._bus = self._open()

    def read(self, timeout_s: float) -> WheelSample | None:
        """The next sample, or None when none came in time. Raises LinkLost."""
        deadline = time.monotonic() + timeout_s
        while True:
            left_s = max(0.0, deadline - time.monotonic())
            message = self._receive(min(left_s, _SLICE_S))
            sample = None if message is None else self._take(message)
            if sample is not None or time.monotonic() >= deadline:
                return sample

    def info(self) -> DeviceInfo:
        settings, decoder = self._settings, self._decoder
        frames = ", ".join(f"{number:#x}" for number, _ in decoder.identifiers)
        return DeviceInfo(
            model=f"wheel encoders on {settings.interface}",
            address=settings.channel,
            facts=(
                ("frames", frames),
                ("DBC file", settings.dbc),
                ("lost frames", str(decoder.lost)),
                ("counting started anew", str(decoder.segment)),
            ),
        )

    def status(self) -> tuple[int, str | None]:
        """(unusable frames so far, what hinders counting now or None)."""
        errors = self._errors + self._decoder.dropped
        if self._hindrance is not None:
            return errors, self._hindrance
        now_ns = time.monotonic_ns()
        ages_s = [
            (now_ns - (self._opened_ns if stamp_ns is None else stamp_ns)) * 1e-9
            for stamp_ns in self._decoder.stamps_ns
        ]
        silent = [
            side
            for side, age_s in zip(("left", "right"), ages_s, strict=True)
            if age_s > self._settings.silence_s
        ]
        if silent:
            return errors, f"no {' and '.join(silent)} wheel counts for {max(ages_s):.1f} s"
        return errors, None

    def close(self) -> None:
        self._closed.set()
        with self._receiving:
            _shut_down(self._bus)

    def _open(self) -> can.BusABC:
        settings = self._settings
        options: dict[str, Any] = {}
        if settings.interface == "slcan":
            # Its default time-out, 1 ms, wakes the processor a thousand times a second.
            options = {"timeout": 0.02, "sleep_after_open": settings.open_delay_s}
        elif settings.interface == "socketcan":
            options["can_filters"] = [
                {"can_id": number, "can_mask": 0x1FFFFFFF, "extended": extended}
                for number, extended in self._decoder.identifiers
            ]
        where = f"{settings.interface} {settings.channel}"
        try:
            return can.Bus(
                interface=settings.interface,
                channel=settings.channel,
                bitrate=settings.bitrate,
                ignore_config=True,
                **options,
            )
        except (NotImplementedError, ValueError) as error:
            raise ValueError(f"{where}: {error}") from error
        except (can.CanError, OSError) as error:
            raise LinkLost(f"{where}: {error}") from error

    def _receive(self, timeout_s: float) -> can.Message | None:
        with self._receiving:
            if self._closed.is_set():
                raise LinkLost(f"{self._settings.channel}: closed")
            self._flush_what_is_old()
            try:
                message = self._bus.recv(timeout_s)
            # slcan meets bad text as ValueError, and a line cut short as IndexError.
            except (can.CanError, OSError, ValueError, IndexError) as error:
                self._judge(error)
                message = None
            self._back_ns = time.monotonic_ns()
            return message

    def _flush_what_is_old(self) -> None:
        """An slcan frame is stamped when it is read: one that waited would be taken for new.

        Flushing in silence also bounds the adapter's buffer, which grows while no line ends.
        """
        now_ns = time.monotonic_ns()
        newest_ns = max(self._flushed_ns, *(ns or 0 for ns in self._decoder.stamps_ns))
        if now_ns - self._back_ns > 1e9 * _SLICE_S or now_ns - newest_ns > 1e9 * _FLUSH_S:
            self._flush()

    def _flush(self) -> None:
        self._flushed_ns = time.monotonic_ns()
        if isinstance(self._bus, slcanBus):
            with contextlib.suppress(can.CanError):  # a dead port tells so when it is read
                self._bus.flush()

    def _judge(self, error: Exception) -> None:
        """Damage on the line is counted; a line that is gone is LinkLost."""
        cause = error.__cause__ if isinstance(error, can.CanError) else error
        self._errors += 1
        self._troubles += 1
        gone = isinstance(cause, OSError) or getattr(error, "error_code", None) is not None
        if gone or self._troubles > _MAX_TROUBLES:
            raise LinkLost(f"{self._settings.channel}: {error}") from error
        # What is not text stays in slcan's buffer and spoils every later line.
        self._flush()

    def _take(self, message: can.Message) -> WheelSample | None:
        frame = _raw(message)
        self._tap(frame)
        # First of all: an error frame's id looks like that of a common frame.
        if message.is_error_frame:
            self._errors += 1
            found = [text for bit, text in _CLASS_OF_ERROR if message.arbitration_id & bit]
            self._hindrance = found[0] if found else self._hindrance
            return None
        if message.is_remote_frame:
            return None
        before = self._decoder.stamps_ns
        try:
            sample = self._decoder.feed(
                frame.stamp_ns,
                frame.arbitration_id,
                frame.data,
                is_extended=frame.extended,
            )
        except BadTelegram as reason:
            self._errors += 1
            self._hindrance = str(reason)
            return None
        if self._decoder.stamps_ns != before:
            self._hindrance = None
            self._troubles = 0
        return sample


def _raw(message: can.Message) -> RawFrame:
    return RawFrame(
        device=WHEELS,
        stamp_ns=_stamp_ns(message.timestamp),
        arbitration_id=message.arbitration_id,
        extended=message.is_extended_id,
        remote=message.is_remote_frame,
        error=message.is_error_frame,
        data=bytes(message.data),
    )


def _stamp_ns(wall_s: float) -> int:
    """The monotonic instant of a frame stamped by the wall clock.

    Converted frame by frame: the wall clock may be set at any time. A stamp of the future or of
    the distant past is no wall clock's; the frame then counts as just received.
    """
    age_s = time.time() - wall_s
    return time.monotonic_ns() - (round(1e9 * age_s) if 0.0 <= age_s <= _MAX_AGE_S else 0)


def _shut_down(bus: can.BusABC) -> None:
    with contextlib.suppress(can.CanError, OSError):
        bus.shutdown()
    if isinstance(bus, slcanBus):
        # Its shutdown gives up before the port is closed when the adapter is gone.
        bus.serialPortOrig.close()
