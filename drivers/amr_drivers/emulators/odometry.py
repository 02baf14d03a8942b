"""The wheels of a configuration on their bus, whichever driver reads them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

from amr_drivers.can_odometry.cia402.settings import Settings as Cia402Settings
from amr_drivers.can_odometry.settings import Settings, WheelSettings
from amr_drivers.emulators.cia402 import EmulatedDrives
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_drivers.emulators.socketcan import EmulatedNodes
from amr_drivers.emulators.wheels import EmulatedWheels


class EmulatedOdometry:
    """Turns when it is told to, and sends what its encoders count. A context manager.

    Behind an slcan adapter, or on a CAN interface that is there (vcan). Raises ValueError for
    other interfaces and for a DBC file that does not fit, OSError when the port or interface
    cannot be had.
    """

    def __init__(self, settings: Settings | Cia402Settings) -> None:
        if settings.interface not in ("slcan", "socketcan"):
            raise ValueError(f"{settings.interface} cannot be emulated; slcan and socketcan can")
        self._settings = settings
        self._angles = dict.fromkeys(settings.joints, 0.0)
        if isinstance(settings, Cia402Settings):
            self.drives = EmulatedDrives(settings)
        else:
            self._wheels = EmulatedWheels(settings)
        self.adapter: EmulatedSlcan | EmulatedNodes
        if settings.interface == "socketcan":
            self.adapter = EmulatedNodes(settings.channel)
        elif settings.channel.startswith("socket://"):
            self.adapter = EmulatedSlcan.over_tcp(urlsplit(settings.channel).port or 0)
        else:
            Path(settings.channel).parent.mkdir(parents=True, exist_ok=True)
            self.adapter = EmulatedSlcan(Path(settings.channel))

    def turn(self, *angles_rad: float, dt_s: float) -> int:
        """The joints have come to these angles, evenly within ``dt_s``: tell so.

        Returns ``time.monotonic_ns()`` of it.
        """
        stamp_ns = time.monotonic_ns()
        before, now = self._angles, dict(zip(self._angles, angles_rad, strict=True))
        self._angles = now
        settings = self._settings
        if isinstance(settings, Cia402Settings):
            frames = [answer for sent in self.adapter.heard() for answer in self.drives.hear(sent)]
            frames += self.drives.cycle(stamp_ns, now, dt_s)
        else:
            told = [
                (now[name] - before[name]) / dt_s
                if isinstance(signal, WheelSettings) and signal.measures == "speed"
                else now[name]
                for name, signal in settings.signals.items()
            ]
            frames = self._wheels.frames(*told)
        for frame in frames:
            self.adapter.send(frame)
        return stamp_ns

    def close(self) -> None:
        """Remove the port. Idempotent."""
        self.adapter.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def emulate(settings: Settings | Cia402Settings) -> EmulatedOdometry:
    """Stand in for the wheels that these driver settings name."""
    return EmulatedOdometry(settings)
