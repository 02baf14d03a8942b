"""The wheels, or another's odometry, out of a recording."""

from __future__ import annotations

from dataclasses import dataclass

from amr_drivers.replay.player import Track
from amr_slam.samples import DeviceInfo, DriveSample, FrameTap, Scan, untapped


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Which recording."""

    log: str
    """Path of the recording: whatever ``amr-slam replay`` takes."""


def open_odometry(settings: Settings, _tap: FrameTap = untapped) -> ReplayOdometry:
    """Start the recording, or join those who play it. Raises ValueError: damaged, no wheels."""
    return ReplayOdometry(settings)


class ReplayOdometry:
    """An :class:`amr_slam.samples.OdometrySource`."""

    def __init__(self, settings: Settings) -> None:
        self._log = settings.log
        self._track = Track(settings.log, None)

    def read(self, timeout_s: float) -> DriveSample | None:
        sample = self._track.read(timeout_s)
        return None if isinstance(sample, Scan) else sample

    def info(self) -> DeviceInfo:
        return DeviceInfo(model="recorded odometry", address=self._log)

    def status(self) -> tuple[int, str | None]:
        return self._track.status()

    def close(self) -> None:
        self._track.close()
