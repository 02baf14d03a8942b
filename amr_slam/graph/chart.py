"""The chart: all scans that joined the map, tied by the way and by the loops that were closed."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2, inverse_matrix, turned
from amr_slam.graph.closing import Closing
from amr_slam.graph.drift import Ties
from amr_slam.graph.posegraph import Edge, optimize, strains
from amr_slam.graph.recalling import Recalling
from amr_slam.graph.submaps import Submaps
from amr_slam.map import PointMap
from amr_slam.params import SlamParams

_STEP: Final = np.diag([0.02**2, 0.02**2, 0.006**2])
"""Covariance that each step of the way has at least: submaps bend."""
_MOVED_M: Final = 0.01
_MOVED_RAD: Final = 0.002
"""A loop that moves the newest pose by less is not worth an announcement."""
_STRAINED_D2: Final = 2.4
"""Loops that are off by less, as half of all by chance, may wait"""
_MOST_WAITING: Final = 12
"""until there are so many: then all poses are found anew."""


class Chart:
    """Nodes, submaps and loops of a map that is made from nothing."""

    def __init__(self, params: SlamParams) -> None:
        self._params = params
        self._closing = Closing(params)
        self._recalling = Recalling(params)
        self._submaps = Submaps(params)
        self._ties = Ties()
        self._sought_m = -np.inf
        self._waiting = 0  # loops that the poses do not know yet
        self.edges: list[Edge] = []
        """Steps of the way, and loops."""
        self._ways_m: list[float] = []
        self.poses: Array = np.empty((0, 3))
        """(n, 3) map_from_base of all nodes, as well as is known now."""
        self.moved = False
        """Poses have changed since this was last set to False."""

    @property
    def local(self) -> PointMap:
        """The newest part of the way: what scans are registered in."""
        return self._submaps.local

    @property
    def newest(self) -> Pose2:
        """Pose of the newest node. There must be one."""
        return self.pose(-1)

    def pose(self, row: int) -> Pose2:
        """map_from_base of a node."""
        return Pose2.from_array(self.poses[row])

    def insert(self, cloud: Cloud, pose: Pose2, covariance: Array) -> Pose2 | None:
        """A scan joins the map at ``pose`` (map_from_base), known to ``covariance`` (3, 3) with
        respect to the node before.

        Where that closes a loop: what takes poses of before to poses of now, at the newest node.
        """
        row = len(self.poses)
        way_m = 0.0
        if row:
            way_m = self._ways_m[-1] + self.newest.distance_to(pose)
            self._tie([_step(row, self.newest, pose, covariance)])
        self.poses = np.concatenate([self.poses, pose.as_array()[np.newaxis]])
        self._ways_m.append(way_m)
        self._submaps.insert(row, cloud, pose, self._ways_m)
        if way_m - self._sought_m < self._params.closing.step_m or not self._submaps.finished:
            return None
        self._sought_m = way_m
        drift = self._ties.drift(self.poses, self._params.closing.drift_model)
        found = self._closing.seek(cloud, self.poses, self._ways_m, drift, self._submaps)
        found += self._recalling.seek(self.poses, self._ways_m, drift, self._submaps)
        if not found:
            return None
        self._tie(found)
        self._waiting += len(found)
        strained = float(strains(self.poses, found).max()) > _STRAINED_D2
        return self._relax() if strained or self._waiting > _MOST_WAITING else None

    def _tie(self, edges: list[Edge]) -> None:
        self.edges += edges
        self._ties.add(edges)

    def _relax(self) -> Pose2 | None:
        """Move all nodes to where steps and loops agree best. What that has moved the newest one
        by, if it is worth an announcement."""
        before = self.newest
        self.poses = optimize(self.poses, self.edges, self._waiting)
        self._waiting, self.moved = 0, True
        moved = self.newest @ before.inverse()
        if self.newest.distance_to(before) < _MOVED_M and abs(moved.theta_rad) < _MOVED_RAD:
            return None
        self._submaps.move(self.poses)
        return moved


def _step(row: int, before: Pose2, after: Pose2, covariance: Array) -> Edge:
    return Edge(
        start=row - 1,
        end=row,
        delta=before.inverse() @ after,
        information=inverse_matrix(turned(covariance, before.rotation.T) + _STEP),
    )
