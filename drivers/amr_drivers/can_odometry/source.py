"""An odometry source on a bus: frames from one, samples by a decoder."""

from __future__ import annotations

import time
from collections import deque

from amr_drivers.can_odometry.bus import CanBus
from amr_drivers.can_odometry.frames import Frame, FrameDecoder
from amr_drivers.can_odometry.settings import BusSettings
from amr_slam.samples import WHEELS, DeviceInfo, FrameTap, JointSample, RawFrame, WheelSample


class CanOdometry:
    """An :class:`amr_slam.samples.OdometrySource`."""

    def __init__(
        self, what: str, settings: BusSettings, decoder: FrameDecoder, tap: FrameTap
    ) -> None:
        """``what`` is on the bus, for people. Raises as :class:`CanBus`."""
        self._tap = tap
        self._what = what
        self._settings = settings
        self._decoder = decoder
        self._samples: deque[WheelSample | JointSample] = deque()
        self._bus = CanBus(settings, decoder.filters)
        self._send()

    def read(self, timeout_s: float) -> WheelSample | JointSample | None:
        """The next sample, or None when none came in time. Raises LinkLost."""
        deadline = time.monotonic() + timeout_s
        while not self._samples:
            frame = self._bus.receive(max(0.0, deadline - time.monotonic()))
            if frame is not None:
                self._tap(_raw(frame))
                self._samples.extend(self._decoder.received(frame))
                self._send()
            if not self._samples and time.monotonic() >= deadline:
                return None
        return self._samples.popleft()

    def info(self) -> DeviceInfo:
        return DeviceInfo(
            model=f"{self._what} on {self._settings.interface}",
            address=self._settings.channel,
            facts=self._decoder.facts(),
        )

    def status(self) -> tuple[int, str | None]:
        """(unusable frames so far, what hinders counting now or None)."""
        errors, hindrance = self._decoder.status(time.monotonic_ns())
        return self._bus.errors + errors, hindrance

    def close(self) -> None:
        self._bus.close()

    def _send(self) -> None:
        for frame in self._decoder.to_send():
            self._bus.send(frame)


def _raw(frame: Frame) -> RawFrame:
    return RawFrame(
        device=WHEELS,
        stamp_ns=frame.stamp_ns,
        identifier=frame.identifier,
        data=frame.data,
        is_extended=frame.is_extended,
        is_error=frame.is_error,
        is_remote=frame.is_remote,
    )
