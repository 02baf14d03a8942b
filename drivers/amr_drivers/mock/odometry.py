"""The wheels of the simulated robot."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge

from amr_drivers.mock.stage import STAGES
from amr_drivers.playing import Hold, deadline_ns
from amr_slam.samples import DeviceInfo, FrameTap, WheelSample, untapped
from amr_slam.simulation import WHEEL_PERIOD_NS


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The simulated robot: wheels of 0.1 m radius, 0.5 m apart."""

    seed: Annotated[int, Ge(0)] = 1
    """Of the laboratory. Devices with the same seed are on the same robot."""

    @property
    def joints(self) -> tuple[str, ...]:
        """What samples tell: the ``[drive]`` must be made for it."""
        return ("left", "right")


def open_odometry(settings: Settings, _tap: FrameTap = untapped) -> MockOdometry:
    """Listen to the simulated robot's wheels; the robot is made when this is its first device."""
    return MockOdometry(settings)


class MockOdometry:
    """An :class:`amr_slam.samples.OdometrySource` of 50 Hz."""

    def __init__(self, settings: Settings) -> None:
        self._seed = settings.seed
        self._hold = Hold(STAGES, settings.seed)
        start_ns = self._hold.value.start_ns
        periods = (time.monotonic_ns() - start_ns) // WHEEL_PERIOD_NS
        self._last_ns = start_ns + periods * WHEEL_PERIOD_NS

    def read(self, timeout_s: float) -> WheelSample | None:
        if not self._hold.wait_until(self._last_ns + WHEEL_PERIOD_NS, deadline_ns(timeout_s)):
            return None
        sample = self._hold.value.wheels_after(self._last_ns)
        self._last_ns = sample.stamp_ns
        return sample

    def info(self) -> DeviceInfo:
        return DeviceInfo(model="simulated wheels", address=f"laboratory {self._seed}")

    def status(self) -> tuple[int, str | None]:
        return 0, None

    def close(self) -> None:
        self._hold.close()
