"""The far end of python-can's multicast bus: unlike an slcan adapter, it passes error frames on."""

from __future__ import annotations

from amr_drivers.can_odometry.bus import CanBus
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import BusSettings


class EmulatedMulticast:
    """Another member of a robot's multicast bus. One thread uses it.

    Raises LinkLost where this machine knows no way to the group, ValueError for a channel that can
    never be one.
    """

    def __init__(self, settings: BusSettings) -> None:
        self.port = settings.channel
        self._bus = CanBus(settings, [])

    def send(self, frame: Frame) -> bool:
        """Send one frame; False when it could not be."""
        errors = self._bus.errors
        self._bus.send(frame)
        return self._bus.errors == errors

    def heard(self) -> list[Frame]:
        """What came over the bus since the last call."""
        frames = []
        while (frame := self._bus.receive(0.0)) is not None:
            frames.append(frame)
        return frames

    def close(self) -> None:
        """Idempotent."""
        self._bus.close()
