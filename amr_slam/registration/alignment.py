"""What every registration method works on and returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.areas import Area
from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.registration import lookup

# How far a correspondence may be sought: rough poses are this wrong, noisy points stray farther.
_LEAST_REACH_M, _MOST_REACH_M = 0.7, 1.0


def _nowhere() -> Array:
    return np.empty((0, 2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """The part of a map that a scan is registered against; arrays are read-only."""

    points_m: Array
    """(n, 2) in the map frame; kept in the order of their x."""
    normals: Array
    """(n, 2) unit normals that face where the wall was seen from; (0, 0) where unknown."""
    spacing_m: float = 0.05
    """Distance of neighbouring points along a wall."""
    sigma_m: float = 0.0
    """Noise of the scans that the points were made of: how far from them a wall may lie."""
    free_m: NDArray[np.float32] | Array = field(default_factory=_nowhere)
    """(k, 2) centres of the cells that rays have passed, walls excepted."""
    cell_m: float = 0.1
    """Side of these cells."""
    zones: tuple[Area, ...] = ()
    """Where nothing is a landmark: the target knows nothing there, and what a scan sees there is
    left out."""

    def __post_init__(self) -> None:
        order = np.argsort(self.points_m[:, 0], kind="stable")
        object.__setattr__(self, "points_m", readonly(self.points_m[order]))
        object.__setattr__(self, "normals", readonly(self.normals[order]))
        free_m = self.free_m.astype(np.float32)
        free_m.flags.writeable = False
        object.__setattr__(self, "free_m", free_m)

    def __len__(self) -> int:
        return len(self.points_m)

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        """Exact nearest-neighbour index over the points, built on first use."""
        return scipy.spatial.cKDTree(self.points_m)

    @cached_property
    def lookup(self) -> lookup.Lookup:
        """Dense nearest-point grid, built on first use. Raises ValueError without points."""
        if not len(self):
            raise ValueError("no points to look up")
        reach_m = min(max(_LEAST_REACH_M, 3.0 * self.sigma_m + 0.1), _MOST_REACH_M)
        return lookup.build(self.points_m, self.normals, self.free_m, self.cell_m, reach_m)


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
