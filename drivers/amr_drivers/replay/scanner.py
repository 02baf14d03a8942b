"""A scanner out of a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

from amr_drivers.replay.player import Track
from amr_slam.samples import DeviceInfo, Scan, Tap, untapped


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Which scanner of which recording."""

    log: str
    """Path of the recording: whatever ``amr-slam replay`` takes."""
    source: str = ""
    """The scanner's name in the recording; empty: the same as in the configuration."""


def open_scanner(name: str, settings: Settings, _tap: Tap = untapped) -> ReplayScanner:
    """Start the recording, or join those who play it. Raises ValueError: damaged, no such name."""
    return ReplayScanner(name, settings)


class ReplayScanner:
    """An :class:`amr_slam.samples.Scanner`."""

    def __init__(self, name: str, settings: Settings) -> None:
        self._name = name
        self._log = settings.log
        self._track = Track(settings.log, settings.source or name)

    def read(self, timeout_s: float) -> Scan | None:
        sample = self._track.read(timeout_s)
        return replace(sample, scanner=self._name) if isinstance(sample, Scan) else None

    def info(self) -> DeviceInfo:
        return DeviceInfo(model="recorded scanner", address=self._log)

    def status(self) -> tuple[int, str | None]:
        return self._track.status()

    def close(self) -> None:
        self._track.close()
