"""What is calibrated, what it is calibrated from, and what came out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2, readonly


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannerMeasures:
    """Where a scanner sits, and how far its clock is off."""

    name: str
    base_from_lidar: Pose2
    lag_s: float = 0.0
    """Its stamps are late by this against the wheels': subtract it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """All that a differential drive's recording can tell of the robot.

    As a vector: left radius, right radius, track (m), then x, y (m), theta (rad) and lag (s) of
    each scanner.
    """

    radius_left_m: float
    radius_right_m: float
    track_m: float
    scanners: tuple[ScannerMeasures, ...]

    def as_array(self) -> Array:
        """(3 + 4 scanners,)."""
        values = [self.radius_left_m, self.radius_right_m, self.track_m]
        for scanner in self.scanners:
            values += [*scanner.base_from_lidar.as_array(), scanner.lag_s]
        return np.array(values)

    def with_values(self, values: Array) -> Measures:
        """The same robot with other numbers."""
        rows = values[3:].reshape(-1, 4)
        return Measures(
            radius_left_m=float(values[0]),
            radius_right_m=float(values[1]),
            track_m=float(values[2]),
            scanners=tuple(
                ScannerMeasures(
                    name=scanner.name,
                    base_from_lidar=Pose2.from_array(row[:3]),
                    lag_s=float(row[3]),
                )
                for scanner, row in zip(self.scanners, rows, strict=True)
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """Poses of the scanners in one map, one for each scan that was found there."""

    scanner: NDArray[np.int64]
    """(n,) number of the scanner."""
    stamps_ns: NDArray[np.int64]
    """(n,) middle of the sweep by the scanner's own clock."""
    poses: Array
    """(n, 3) map_from_lidar."""
    covariances: Array
    """(n, 3, 3) of x, y, theta in the map frame."""

    def __post_init__(self) -> None:
        for name in ("scanner", "stamps_ns"):
            object.__setattr__(self, name, readonly(getattr(self, name), np.int64))
        for name in ("poses", "covariances"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """The measures found, and what they are worth."""

    given: Measures
    """Those of the configuration."""
    measures: Measures
    covariance: Array
    """(k, k) read-only, of ``measures.as_array()``."""
    path: Array
    """(n, 3) read-only: base poses in the map at the sightings, in the order of time."""
    wheel_error: Array
    """(n - 1, 3) read-only: what the wheels said of each interval less what it was, x, y (m) and
    heading (rad) in the frame of its begin, with the calibrated measures."""
    before_error: Array
    """(n - 1, 3) read-only: the same with the measures of the configuration."""
    stamps_ns: NDArray[np.int64]
    """(n,) read-only: instants of ``path``."""

    def __post_init__(self) -> None:
        for name in ("covariance", "path", "wheel_error", "before_error"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        object.__setattr__(self, "stamps_ns", readonly(self.stamps_ns, np.int64))

    @property
    def sigmas(self) -> Array:
        """(k,) standard deviations of ``measures.as_array()``."""
        return np.sqrt(np.diag(self.covariance))

    def doubts(self) -> tuple[str, ...]:
        """What this drive does not tell well enough to be used, in words; empty: use it all."""
        return tuple(_doubts(self.measures, self.sigmas))


RADIUS_LIMIT = 0.005
"""A wheel radius or the track is told when its standard deviation is below this share of it."""
PLACE_LIMIT_M = 0.02
ANGLE_LIMIT_RAD = math.radians(0.5)
LAG_LIMIT_S = 0.02


def _doubts(measures: Measures, sigmas: Array) -> list[str]:
    said = []
    if max(sigmas[0] / measures.radius_left_m, sigmas[1] / measures.radius_right_m) > RADIUS_LIMIT:
        said.append("wheel radii: drive further, and both straight ahead and in curves")
    if sigmas[2] / measures.track_m > RADIUS_LIMIT:
        said.append("track: turn more, to the left and to the right")
    rows: Sequence[Array] = list(sigmas[3:].reshape(-1, 4))
    for scanner, row in zip(measures.scanners, rows, strict=True):
        if max(row[0], row[1]) > PLACE_LIMIT_M:
            said.append(f"{scanner.name}: place: turn more on the spot, to both sides")
        if row[2] > ANGLE_LIMIT_RAD:
            said.append(f"{scanner.name}: angle: drive straight ahead for some metres")
        if row[3] > LAG_LIMIT_S:
            said.append(f"{scanner.name}: clock: begin and end turns briskly")
    return said
