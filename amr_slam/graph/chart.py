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
from amr_slam.map.ties import MapTies
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
_URGENT_D2: Final = 16.27
"""A loop that is off by more than chance allows waits for nothing. All others wait, too,"""
_PATIENCE: Final = 300
"""until the chart has grown by this part of it: however large it is, a scan costs the same."""


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
        self._relaxed = 0  # nodes that there were when poses were found anew last
        self.edges: list[Edge] = []
        """Steps of the way, and loops."""
        self._ways_m: list[float] = []
        self.poses: Array = np.empty((0, 3))
        """(n, 3) map_from_base of all nodes, as well as is known now."""
        self.moved = False
        """Poses have changed since this was last set to False."""

    @staticmethod
    def restored(params: SlamParams, known: PointMap) -> Chart | None:
        """The chart that a map was made with, its pieces made anew at the poses of now; None where
        the map does not know how its scans are tied."""
        ties = known.ties
        steps = ties.ends[~ties.loops & (ties.ends == ties.starts + 1)]
        if len(np.unique(steps)) != len(known.path) - 1:
            return None
        chart = Chart(params)
        chart.poses = np.array([pose.as_array() for _, pose in known.path])
        away_m = np.hypot(*np.diff(chart.poses[:, :2], axis=0).T)
        chart._ways_m = [0.0, *(float(way_m) for way_m in np.cumsum(away_m))]
        chart._sought_m = chart._ways_m[-1]
        chart._tie([_edge(ties, row) for row in range(len(ties))])
        for row, (stamp_ns, pose) in enumerate(known.path):
            if len(known.rays[row]):
                cloud = known.rays[row].cloud(stamp_ns, known.noises_m[row])
                chart._submaps.insert(row, cloud, pose, chart._ways_m)
        return chart

    def ties(self) -> MapTies:
        """All steps and loops, for the map to keep."""
        return MapTies(
            starts=np.array([edge.start for edge in self.edges], dtype=np.int64),
            ends=np.array([edge.end for edge in self.edges], dtype=np.int64),
            deltas=np.array([edge.delta.as_array() for edge in self.edges]).reshape(-1, 3),
            informations=np.array([edge.information for edge in self.edges]).reshape(-1, 3, 3),
            loops=np.array([edge.loop for edge in self.edges], dtype=np.bool_),
        )

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
        rules = self._params.closing
        due = way_m - self._sought_m >= rules.step_m and len(self._submaps.finished) > 0
        if not rules.enabled or not due:
            return None
        self._sought_m = way_m
        drift = self._ties.drift(self.poses, rules.drift_model)
        found = self._closing.seek(cloud, self.poses, self._ways_m, drift, self._submaps)
        found += self._recalling.seek(self.poses, self._ways_m, drift, self._submaps)
        if not found:
            return None
        self._tie(found)
        self._waiting += len(found)
        strain = float(strains(self.poses, found).max())
        wanted = strain > _STRAINED_D2 or self._waiting > _MOST_WAITING
        grown = row - self._relaxed >= row // _PATIENCE
        return self._relax() if strain > _URGENT_D2 or (wanted and grown) else None

    def _tie(self, edges: list[Edge]) -> None:
        self.edges += edges
        self._ties.add(edges)

    def _relax(self) -> Pose2 | None:
        """Move all nodes to where steps and loops agree best. What that has moved the newest one
        by, if it is worth an announcement."""
        before = self.newest
        self.poses = optimize(self.poses, self.edges, self._waiting)
        self._waiting, self._relaxed, self.moved = 0, len(self.poses), True
        moved = self.newest @ before.inverse()
        if self.newest.distance_to(before) < _MOVED_M and abs(moved.theta_rad) < _MOVED_RAD:
            return None
        self._submaps.move(self.poses)
        return moved


def _edge(ties: MapTies, row: int) -> Edge:
    return Edge(
        start=int(ties.starts[row]),
        end=int(ties.ends[row]),
        delta=Pose2.from_array(ties.deltas[row]),
        information=ties.informations[row],
        loop=bool(ties.loops[row]),
    )


def _step(row: int, before: Pose2, after: Pose2, covariance: Array) -> Edge:
    return Edge(
        start=row - 1,
        end=row,
        delta=before.inverse() @ after,
        information=inverse_matrix(turned(covariance, before.rotation.T) + _STEP),
    )
