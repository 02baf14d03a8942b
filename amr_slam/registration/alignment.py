"""What every registration method works on and returns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from amr_slam.geometry import Array, Pose2, readonly

# A wall seen from its other side counts as this much times two farther away.
_SIDE_M = 0.2


def facing(points_m: Array, normals: Array) -> Array:
    """(..., 4) features whose distance is that of the points, plus that of their directions."""
    return np.concatenate([points_m, _SIDE_M * normals], axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """The part of a map that a scan is registered against; arrays are read-only."""

    points_m: Array
    """(n, 2) in the map frame."""
    normals: Array
    """(n, 2) unit normals that face where the wall was seen from; (0, 0) where unknown."""
    spacing_m: float = 0.05
    """Distance of neighbouring points along a wall."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", readonly(self.points_m))
        object.__setattr__(self, "normals", readonly(self.normals))

    def __len__(self) -> int:
        return len(self.points_m)

    @cached_property
    def tree(self) -> cKDTree:
        """Nearest-neighbour index over the points, built on first use."""
        return cKDTree(self.points_m)

    @cached_property
    def facing_tree(self) -> cKDTree:
        """Index over :func:`facing` of the points: the two sides of a thin wall lie apart."""
        return cKDTree(facing(self.points_m, self.normals))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """Where a method put the source, and how sure it may be. Failing to converge is data."""

    target_from_source: Pose2
    information: Array
    """(3, 3) read-only: inverse covariance of (x, y, theta) in the target frame, from the
    source's points alone (no prior), assuming independent points of the measured noise."""
    converged: bool
    iterations: int
    inliers: float
    """Share (0..1) of the source's points that found a correspondence."""
    rmse_m: float
    """Root mean square residual of those."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "information", readonly(self.information))
