"""Pieces of the way, each with a map of its own.

A map of the last few dozen metres does not know how far the way has drifted: what is seen again
after a round is no contradiction to it, and the cost of a scan does not grow with the whole map.
Two pieces overlap at any time. Scans are registered in the older one and join both; when that is
long enough, it is kept for loops to be closed with, and the younger one takes over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.map import MapParams, PointMap


@dataclass(slots=True, kw_only=True, eq=False)
class Submap:
    """One piece. Its frame is where it was made: what loops move later is where that frame lies."""

    map: PointMap
    rows: list[int] = field(default_factory=list)
    """Of the nodes whose scans it is made of."""
    poses: list[Pose2] = field(default_factory=list)
    """Of these nodes, in the submap's frame."""

    def insert(self, row: int, cloud: Cloud, pose: Pose2) -> None:
        """Add the scan of a node."""
        self.map.insert(cloud, pose)
        self.rows.append(row)
        self.poses.append(pose)

    def map_from_submap(self, poses: Array) -> Pose2:
        """Where its frame lies, by the node in its middle; ``poses`` (n, 3): of all nodes."""
        middle = len(self.rows) // 2
        return Pose2.from_array(poses[self.rows[middle]]) @ self.poses[middle].inverse()

    def nearest(self, pose: Pose2) -> tuple[float, int]:
        """Distance in m to the nearest of its nodes, and that one's number in it."""
        return min((one.distance_to(pose), number) for number, one in enumerate(self.poses))

    def rebuilt(self, poses: Array) -> Submap:
        """The same scans at the poses (n, 3) that all nodes have now."""
        moved = [Pose2.from_array(poses[row]) for row in self.rows]
        return Submap(map=self.map.rebuilt(moved), rows=list(self.rows), poses=moved)


class Submaps:
    """The two that grow, and those that are finished."""

    def __init__(self, params: MapParams, length_m: float) -> None:
        self._params = params
        self._length_m = length_m
        self._older = Submap(map=PointMap(params))
        self._younger: Submap | None = None
        self.finished: list[Submap] = []

    @property
    def local(self) -> PointMap:
        """What scans are registered in; its frame is that of the whole map, as of now."""
        return self._older.map

    def insert(self, row: int, cloud: Cloud, pose: Pose2, ways_m: Sequence[float]) -> None:
        """Add the scan of a node; ``ways_m``: driven up to each node."""
        self._older.insert(row, cloud, pose)
        way_m = ways_m[row] - ways_m[self._older.rows[0]]
        if self._younger is None and way_m > 0.5 * self._length_m:
            self._younger = Submap(map=PointMap(self._params))
        if self._younger is not None:
            self._younger.insert(row, cloud, pose)
            if way_m > self._length_m:
                self.finished.append(self._older)
                self._older, self._younger = self._younger, None

    def move(self, poses: Array) -> None:
        """Loops have moved the nodes: what grows follows, what is finished keeps its shape."""
        self._older = self._older.rebuilt(poses)
        if self._younger is not None:
            self._younger = self._younger.rebuilt(poses)
