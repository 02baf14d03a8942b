"""The wheels of a configuration on their bus, whichever driver reads them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

from amr_drivers.can_odometry.cia402.settings import Settings as Cia402Settings
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import Settings, WheelSettings
from amr_drivers.emulators.can_faults import FaultyWire
from amr_drivers.emulators.cia402 import EmulatedDrives
from amr_drivers.emulators.multicast import EmulatedMulticast
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_drivers.emulators.socketcan import EmulatedNodes
from amr_drivers.emulators.wheels import EmulatedWheels


class EmulatedOdometry:
    """Turns when it is told to, and sends what its encoders count. A context manager.

    Behind an slcan adapter, on a multicast group, or on a CAN interface that is there (vcan).
    Raises ValueError for other interfaces and for a DBC file that does not fit, OSError when the
    port or interface cannot be had.
    """

    def __init__(self, settings: Settings | Cia402Settings) -> None:
        if settings.interface not in ("slcan", "udp_multicast", "socketcan"):
            raise ValueError(
                f"{settings.interface} cannot be emulated; slcan, udp_multicast and socketcan can"
            )
        self._settings = settings
        self._angles = dict.fromkeys(settings.joints, 0.0)
        if isinstance(settings, Cia402Settings):
            self.drives = EmulatedDrives(settings)
        else:
            self._wheels = EmulatedWheels(settings)
        self.adapter = _adapter(settings)
        self.wire = FaultyWire(self.adapter.send)
        """What lies between the encoders and the adapter."""
        self.pass_on: Callable[[Sequence[Frame]], object] = self.wire.send
        """What the wire does with the frames of each turn."""

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
        self.pass_on(frames)
        return stamp_ns

    def restart(self) -> None:
        """The node that counts lost its power where it stands now: it counts from 0 again.

        Raises TypeError for drives, which are restarted one by one.
        """
        if isinstance(self._settings, Cia402Settings):
            raise TypeError("drives are restarted one by one")
        self._wheels.restart(*self._angles.values())

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


def _adapter(
    settings: Settings | Cia402Settings,
) -> EmulatedSlcan | EmulatedMulticast | EmulatedNodes:
    if settings.interface == "socketcan":
        return EmulatedNodes(settings.channel)
    if settings.interface == "udp_multicast":
        return EmulatedMulticast(settings)
    if settings.channel.startswith("socket://"):
        return EmulatedSlcan.over_tcp(urlsplit(settings.channel).port or 0)
    Path(settings.channel).parent.mkdir(parents=True, exist_ok=True)
    return EmulatedSlcan(Path(settings.channel))
