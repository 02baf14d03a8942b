"""A CAN bus of any kind that python-can knows. The only module that imports it."""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Any, Final

import can
from can.interfaces.slcan import slcanBus

from amr_drivers.can_odometry.frames import Filter, Frame
from amr_drivers.can_odometry.settings import BusSettings
from amr_drivers.errors import LinkLost

_SLICE_S: Final = 0.1
"""Longest single wait: what ``close`` from another thread may have to wait for."""
_MAX_TROUBLES: Final = 100
"""Unreadable frames in a row after which the adapter is no adapter any more."""
_MAX_AGE_S: Final = 10.0
"""A frame cannot have waited for longer: the sender's clock, not ours, has stamped it."""
_FLUSH_S: Final = 1.0
_TCP_SILENCE_S: Final = 2.0
"""A TCP connection without a frame for so long is made anew: a pulled cable does not tell."""


class CanBus:
    """An open bus. One thread receives and sends; ``close`` may come from another.

    Raises LinkLost when the bus cannot be opened, ValueError for settings that can never work.
    """

    def __init__(self, settings: BusSettings, filters: list[Filter]) -> None:
        self._channel = settings.channel
        self._is_tcp = settings.channel.startswith("socket://")
        self._troubles = 0
        self._receiving = threading.Lock()
        self._closed = threading.Event()
        self._back_ns = self._heard_ns = self._flushed_ns = time.monotonic_ns()
        self.errors = 0
        """Unreadable frames, and frames that could not be sent."""
        self._bus = _open(settings, filters)

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None when none came within ``timeout_s`` or 0.1 s, or when one was
        unreadable. Raises LinkLost."""
        with self._receiving:
            if self._closed.is_set():
                raise LinkLost(f"{self._channel}: closed")
            self._flush_what_is_old()
            try:
                message = self._bus.recv(min(timeout_s, _SLICE_S))
            # slcan meets bad text as ValueError, and a line cut short as IndexError.
            except (can.CanError, OSError, ValueError, IndexError) as error:
                self._judge(error)
                message = None
            self._back_ns = time.monotonic_ns()
            if message is None:
                self._refuse_silence()
                return None
            self._heard_ns, self._troubles = self._back_ns, 0
            return _frame(message)

    def send(self, frame: Frame) -> None:
        """Send a frame; what cannot be sent is counted: a lost bus is seen when it is read."""
        message = can.Message(
            arbitration_id=frame.identifier,
            data=frame.data,
            is_extended_id=frame.is_extended,
            is_error_frame=frame.is_error,
        )
        with self._receiving:
            try:
                if not self._closed.is_set():
                    self._bus.send(message)
            except (can.CanError, OSError):
                self.errors += 1

    def close(self) -> None:
        """Idempotent."""
        self._closed.set()
        with self._receiving:
            _shut_down(self._bus)

    def _flush_what_is_old(self) -> None:
        """An slcan frame is stamped when it is read: one that waited would be taken for new.

        Flushing in silence also bounds the adapter's buffer, which grows while no line ends.
        """
        now_ns = time.monotonic_ns()
        newest_ns = max(self._flushed_ns, self._heard_ns)
        if now_ns - self._back_ns > 1e9 * _SLICE_S or now_ns - newest_ns > 1e9 * _FLUSH_S:
            self._flush()

    def _refuse_silence(self) -> None:
        silent_s = 1e-9 * (self._back_ns - self._heard_ns)
        if self._is_tcp and silent_s > _TCP_SILENCE_S:
            raise LinkLost(f"{self._channel}: silent for {silent_s:.1f} s")

    def _flush(self) -> None:
        self._flushed_ns = time.monotonic_ns()
        if isinstance(self._bus, slcanBus):
            with contextlib.suppress(can.CanError):  # a dead port tells so when it is read
                self._bus.flush()

    def _judge(self, error: Exception) -> None:
        """Damage on the line is counted; a line that is gone is LinkLost."""
        cause = error.__cause__ if isinstance(error, can.CanError) else error
        self.errors += 1
        self._troubles += 1
        gone = isinstance(cause, OSError) or getattr(error, "error_code", None) is not None
        if gone or self._troubles > _MAX_TROUBLES:
            raise LinkLost(f"{self._channel}: {error}") from error
        # What is not text stays in slcan's buffer and spoils every later line.
        self._flush()


def _open(settings: BusSettings, filters: list[Filter]) -> can.BusABC:
    options: dict[str, Any] = {}
    channel = settings.channel
    if settings.interface == "slcan":
        # Its default time-out, 1 ms, wakes the processor a thousand times a second.
        options = {"timeout": 0.02, "sleep_after_open": settings.open_delay_s}
    elif settings.interface == "socketcan":
        # The kernel's: it lets error frames pass. Elsewhere python-can's own would drop them.
        options["can_filters"] = [
            {"can_id": wanted.identifier, "can_mask": wanted.mask, "extended": wanted.is_extended}
            for wanted in filters
        ]
    elif settings.interface == "udp_multicast":
        # A stand-in for a bus: it never leaves this machine.
        options["hop_limit"] = 0
        channel, _, port = channel.partition("@")
        if port:
            options["port"] = _port(port)
    where = f"{settings.interface} {settings.channel}"
    try:
        return can.Bus(
            interface=settings.interface,
            channel=channel,
            bitrate=settings.bitrate,
            ignore_config=True,
            **options,
        )
    except (NotImplementedError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from error
    except (can.CanError, OSError) as error:
        raise LinkLost(f"{where}: {error}") from error


def _port(text: str) -> int:
    if not (text.isdecimal() and 0 < int(text) < 65536):
        raise ValueError(f"udp_multicast: {text!r} is no port; the channel is GROUP or GROUP@PORT")
    return int(text)


def _frame(message: can.Message) -> Frame:
    return Frame(
        stamp_ns=_stamp_ns(message.timestamp),
        identifier=message.arbitration_id,
        data=bytes(message.data),
        is_extended=message.is_extended_id,
        is_error=message.is_error_frame,
        is_remote=message.is_remote_frame,
    )


def _stamp_ns(wall_s: float) -> int:
    """The monotonic instant of a frame stamped by the wall clock.

    Converted frame by frame: the wall clock may be set at any time. A stamp of the future or of
    the distant past is no wall clock's; the frame then counts as just received.
    """
    age_s = time.time() - wall_s
    return time.monotonic_ns() - (round(1e9 * age_s) if 0.0 <= age_s <= _MAX_AGE_S else 0)


def _shut_down(bus: can.BusABC) -> None:
    port = bus.serialPortOrig if isinstance(bus, slcanBus) else None
    # pyserial leaves the socket of a socket:// port open when its other end has hung up first.
    connection = getattr(port, "_socket", None)
    with contextlib.suppress(can.CanError, OSError):
        bus.shutdown()
    if port is not None:
        # The bus's shutdown gives up before the port is closed when the adapter is gone.
        port.close()
    if connection is not None:
        connection.close()
