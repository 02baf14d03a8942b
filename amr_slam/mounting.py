"""Where a scanner sits on the robot, and what of the robot stands in its view."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Gt, Interval
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Scan


@dataclass(frozen=True, slots=True, kw_only=True)
class Mask:
    """A sector in which a scanner sees the robot itself, or nothing that should count."""

    from_deg: Annotated[float, Interval(ge=-360, le=360)]
    """First bearing, seen from above: counter-clockwise from the direction ``theta_deg``."""
    to_deg: Annotated[float, Interval(ge=-360, le=360)]
    """Last bearing: greater than the first."""
    closer_than_m: Annotated[float, Gt(0.0)] | None = None
    """Only nearer readings are dropped; without it, all of the sector."""

    def __post_init__(self) -> None:
        width = self.to_deg - self.from_deg
        if width <= 0.0:
            raise ValueError(
                f"from_deg {self.from_deg:g} should be below to_deg {self.to_deg:g}: a sector "
                "behind the scanner reads 170 to 190"
            )
        if width >= 360.0 and self.closer_than_m is None:
            raise ValueError("masks every beam; closer_than_m is missing")

    def covers(self, bearings_rad: Array, ranges_m: Array) -> NDArray[np.bool_]:
        """(n,) whether readings at these bearings are dropped."""
        after = np.remainder(np.degrees(bearings_rad) - self.from_deg + 1e-9, 360.0)
        inside = after <= self.to_deg - self.from_deg + 2e-9
        with np.errstate(invalid="ignore"):
            near = ranges_m < (np.inf if self.closer_than_m is None else self.closer_than_m)
        return np.asarray(inside & near)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """Where a scanner sits on the robot."""

    base_from_lidar: Pose2
    upside_down: bool = False
    lag_s: float = 0.0
    """How late its stamps are against the wheels' clock."""
    masks: tuple[Mask, ...] = ()

    def bearings_rad(self, scan: Scan) -> Array:
        """(n,) of the beams, counter-clockwise seen from above, from the direction of the
        mounting: a scanner that hangs turns the other way."""
        return -scan.angles_rad if self.upside_down else scan.angles_rad

    def masked(self, scan: Scan) -> Scan:
        """The scan without what the masks cover: those beams have not measured."""
        if not self.masks:
            return scan
        bearings = self.bearings_rad(scan)
        covered = np.zeros(len(bearings), dtype=np.bool_)
        for mask in self.masks:
            covered |= mask.covers(bearings, scan.ranges_m)
        return replace(scan, ranges_m=np.where(covered, np.nan, scan.ranges_m))
