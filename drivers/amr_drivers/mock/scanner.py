"""A simulated S300 on the simulated robot."""

from __future__ import annotations

import math
import time
import zlib
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from amr_drivers.mock.stage import STAGES
from amr_drivers.playing import Hold, deadline_ns
from amr_slam.geometry import Pose2
from amr_slam.samples import DeviceInfo, Scan, Tap, untapped
from amr_slam.simulation import ScannerModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The simulated robot, and where on it this scanner is."""

    seed: Annotated[int, Ge(0)] = 1
    """Of the laboratory. Devices with the same seed are on the same robot."""
    x_m: float = 0.24
    """Where the scanner is in the base frame: the same as in the scanner's mounting."""
    y_m: float = 0.2
    theta_deg: Annotated[float, Ge(-180), Le(180)] = 45.0
    """Where it looks, counter-clockwise from straight ahead."""
    period_s: Annotated[float, Gt(0.04), Le(10)] = 2.0
    """Time between two scans."""
    sigma_range_m: Annotated[float, Ge(0), Le(1)] = 0.01
    """Standard deviation of a range."""


def open_scanner(name: str, settings: Settings, _tap: Tap = untapped) -> MockScanner:
    """Put a scanner onto the simulated robot, which is made when it is the first."""
    return MockScanner(name, settings)


class MockScanner:
    """An :class:`amr_slam.samples.Scanner`."""

    def __init__(self, name: str, settings: Settings) -> None:
        self._settings = settings
        self._model = ScannerModel(
            name=name,
            base_from_lidar=Pose2(settings.x_m, settings.y_m, math.radians(settings.theta_deg)),
            sigma_range_m=settings.sigma_range_m,
        )
        self._rng = np.random.default_rng([settings.seed, zlib.crc32(name.encode())])
        self._hold = Hold(STAGES, settings.seed)
        self._period_ns = round(1e9 * settings.period_s)
        self._sweep_ns = round(1e9 * self._model.sweep_s)
        self._next = self._newest_due() + 1

    def read(self, timeout_s: float) -> Scan | None:
        deadline = deadline_ns(timeout_s)
        # Who was away gets the newest scan, not all that he missed.
        seq = self._next = max(self._next, self._newest_due())
        stamp_ns = self._hold.value.start_ns + seq * self._period_ns
        if not self._hold.wait_until(stamp_ns + self._sweep_ns, deadline):
            return None
        self._next = seq + 1
        return self._hold.value.scan(self._model, stamp_ns, self._rng, seq)

    def info(self) -> DeviceInfo:
        return DeviceInfo(
            model="simulated scanner",
            address=f"laboratory {self._settings.seed}",
            facts=(("beams", str(self._model.beams)),),
        )

    def status(self) -> tuple[int, str | None]:
        return 0, None

    def close(self) -> None:
        self._hold.close()

    def _newest_due(self) -> int:
        """Number of the newest sweep that has ended; -1 before the first."""
        passed_ns = time.monotonic_ns() - self._sweep_ns - self._hold.value.start_ns
        return max(-1, passed_ns // self._period_ns)
