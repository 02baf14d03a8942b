"""A map of which one part never changes, however much joins it."""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.map.pointmap import PointMap

_NEAR_M: Final = 0.25
"""What is seen this near to a held wall, and three times the noise, is that wall."""


class Held:
    """Lets scans join a map around what it holds: all that is in the map at first."""

    def __init__(self, grown: PointMap) -> None:
        self._grown = grown
        self._walls = (grown.walls.keys.copy(), grown.walls.sums.copy())
        self._space = (grown.space.keys.copy(), grown.space.sums.copy())
        sums = self._walls[1].astype(np.float64)
        self._tree = scipy.spatial.cKDTree(sums[:, 1:3] / sums[:, :1])
        self._cell_m = grown.walls.cell_m

    def insert(self, cloud: Cloud, map_from_base: Pose2) -> None:
        """Add one accepted scan at its pose: what it shows beside the held part."""
        grown, points = self._grown, map_from_base @ cloud.points_m
        beside = self._beside(points, cloud.across_m)
        grown.insert(cloud, map_from_base)
        # A map that is rebuilt from its rays must find nothing of the held part in them either.
        grown.rays[-1] = grown.rays[-1].take(beside)
        if grown.walls.cell_m == self._cell_m:  # else all cells have been doubled, once
            self._give_back(np.unique(grown.walls.keys_of(points[~beside])))

    def _beside(self, points: Array, across_m: float) -> NDArray[np.bool_]:
        """Which points (n, 2) lie on floor that the held part does not know, off its walls."""
        if not len(points):
            return np.empty(0, dtype=np.bool_)
        unknown = ~np.isin(self._grown.space.keys_of(points), self._space[0])
        near_m = _NEAR_M + 3.0 * across_m
        off = np.asarray(self._tree.query(points, distance_upper_bound=near_m)[0])
        return np.asarray(unknown & ~np.isfinite(off))

    def _give_back(self, touched: NDArray[np.int64]) -> None:
        """The held cells as they were, and none of the ``touched`` wall cells beside them."""
        for grid, (keys, sums) in (
            (self._grown.walls, self._walls),
            (self._grown.space, self._space),
        ):
            grid.sums[grid.find(keys)] = sums
        walls = self._grown.walls
        walls_kept = ~np.isin(walls.keys, np.setdiff1d(touched, self._walls[0]))
        walls.keys, walls.sums = walls.keys[walls_kept], walls.sums[walls_kept]
