"""Pieces of the way, each with a map of its own.

A map of the last few dozen metres does not know how far the way has drifted: what is seen again
after a round is no contradiction to it, and the cost of a scan does not grow with the whole map.
Two pieces overlap at any time. Scans are registered in the older one and join both; when that is
long enough, it is kept for loops to be closed with, and the younger one takes over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import scipy

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.registration import rdnm
from amr_slam.registration.alignment import Target
from amr_slam.registration.rdnm import Packed

_IN_USE: Final = 24
"""Finished pieces whose look-ups are kept: some megabytes each, made anew in milliseconds."""


@dataclass(slots=True, kw_only=True, eq=False)
class Growing:
    """A piece that scans join."""

    map: PointMap
    rows: list[int] = field(default_factory=list)
    """Of the nodes whose scans it is made of."""
    poses: list[Pose2] = field(default_factory=list)
    """Of these nodes."""

    def insert(self, row: int, cloud: Cloud, pose: Pose2) -> None:
        """Add the scan of a node."""
        self.map.insert(cloud, pose)
        self.rows.append(row)
        self.poses.append(pose)

    def rebuilt(self, poses: Array) -> Growing:
        """The same scans at the poses (n, 3) that all nodes have now."""
        moved = [Pose2.from_array(poses[row]) for row in self.rows]
        return Growing(map=self.map.rebuilt(moved), rows=list(self.rows), poses=moved)

    def finished(self, params: SlamParams) -> Submap:
        """It joins no scan any more."""
        near = scipy.spatial.cKDTree(np.array([pose.translation for pose in self.poses]))
        places = self.map.places(params.grid_m, params.robot_radius_m)
        away_m = np.asarray(near.query(places)[0]) if len(places) else np.empty(0)
        target = self.map.target()
        places = places[away_m <= params.closing.beyond_m]
        return Submap(
            rows=np.array(self.rows),
            poses=readonly(np.array([pose.as_array() for pose in self.poses])),
            target=replace(target),
            places=places,
            signatures=rdnm.of_map(target, places, params.rdnm),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Submap:
    """A finished piece. Its frame is where it was made: what loops move later is where that frame
    lies."""

    rows: np.ndarray[tuple[int], np.dtype[np.int64]]
    """(k,) of the nodes whose scans it is made of."""
    poses: Array
    """(k, 3) of these nodes, in the submap's frame."""
    target: Target
    """Its walls. Registered in is :meth:`Submaps.target`, which remembers the look-up."""
    places: Array
    """(m, 2) where a robot may stand that is near the piece's way."""
    signatures: Packed
    """(m, sections) of the walls, seen from there."""

    @property
    def middle(self) -> int:
        """The node in its middle."""
        return int(self.rows[len(self.rows) // 2])

    def map_from_submap(self, poses: Array) -> Pose2:
        """Where its frame lies, by the node in its middle; ``poses`` (n, 3): of all nodes."""
        submap_from_node = Pose2.from_array(self.poses[len(self.rows) // 2])
        return Pose2.from_array(poses[self.middle]) @ submap_from_node.inverse()

    def nearest(self, pose: Pose2) -> tuple[float, int]:
        """Distance in m to the nearest of its nodes, and that one's number in it."""
        away_m = np.hypot(*(self.poses[:, :2] - pose.translation).T)
        number = int(np.argmin(away_m))
        return float(away_m[number]), number


class Submaps:
    """The two that grow, and those that are finished."""

    def __init__(self, params: SlamParams) -> None:
        self._params = params
        self._older = Growing(map=PointMap(params.map))
        self._younger: Growing | None = None
        self.finished: list[Submap] = []
        self._rows = np.empty(0, dtype=np.intp)  # of all that are finished, one after the other
        self._firsts: list[int] = []
        self._in_use: dict[int, Target] = {}

    @property
    def local(self) -> PointMap:
        """What scans are registered in; its frame is that of the whole map, as of now."""
        return self._older.map

    def target(self, number: int) -> Target:
        """The walls of a finished piece, to register in."""
        target = self._in_use.pop(number, None)
        if target is None:
            target = replace(self.finished[number].target)
        self._in_use[number] = target  # the last to go
        if len(self._in_use) > _IN_USE:
            del self._in_use[next(iter(self._in_use))]
        return target

    def least(self, values: Array) -> Array:
        """(m,) of each finished piece, the least of its nodes' values; ``values`` (n,): of all
        nodes. There must be a piece."""
        return np.asarray(np.minimum.reduceat(values[self._rows], self._firsts))

    def away_m(self, poses: Array, pose: Pose2) -> Array:
        """(m,) of each finished piece, the distance of the node in its middle from a pose."""
        middles = [submap.middle for submap in self.finished]
        return np.asarray(np.hypot(*(poses[middles, :2] - pose.translation).T))

    def insert(self, row: int, cloud: Cloud, pose: Pose2, ways_m: Sequence[float]) -> None:
        """Add the scan of a node; ``ways_m``: driven up to each node."""
        length_m = self._params.closing.submap_m
        self._older.insert(row, cloud, pose)
        way_m = ways_m[row] - ways_m[self._older.rows[0]]
        if self._younger is None and way_m > 0.5 * length_m:
            self._younger = Growing(map=PointMap(self._params.map))
        if self._younger is not None:
            self._younger.insert(row, cloud, pose)
            if way_m > length_m:
                self._firsts.append(len(self._rows))
                self._rows = np.concatenate([self._rows, self._older.rows])
                self.finished.append(self._older.finished(self._params))
                self._older, self._younger = self._younger, None

    def piece(self, ways_m: Sequence[float], length_m: float, apart_m: float) -> Cloud:
        """The scans of the last ``length_m`` of way, taken ``apart_m`` apart, as one cloud in the
        newest node's base frame."""
        grown = self._older
        base_from_map = grown.poses[-1].inverse()
        clouds, last_m = [], np.inf
        for number in range(len(grown.rows) - 1, -1, -1):
            way_m = ways_m[grown.rows[number]]
            if ways_m[grown.rows[-1]] - way_m > length_m:
                break
            if last_m - way_m < apart_m:
                continue
            last_m = way_m
            stamp_ns = grown.map.path[number][0]
            cloud = grown.map.rays[number].cloud(stamp_ns, grown.map.noises_m[number])
            clouds.append(_moved(cloud, base_from_map @ grown.poses[number]))
        return _joined(clouds)

    def move(self, poses: Array) -> None:
        """Loops have moved the nodes: what grows follows, what is finished keeps its shape."""
        self._older = self._older.rebuilt(poses)
        if self._younger is not None:
            self._younger = self._younger.rebuilt(poses)


def _moved(cloud: Cloud, pose: Pose2) -> Cloud:
    return replace(
        cloud,
        points_m=pose @ cloud.points_m,
        normals=cloud.normals @ pose.rotation.T,
        origins_m=pose @ cloud.origins_m,
    )


def _joined(clouds: Sequence[Cloud]) -> Cloud:
    """One cloud of several in the same frame; there must be one."""
    return Cloud(
        stamp_ns=clouds[0].stamp_ns,
        points_m=np.concatenate([one.points_m for one in clouds]),
        normals=np.concatenate([one.normals for one in clouds]),
        origins_m=np.concatenate([one.origins_m for one in clouds]),
        weights=np.concatenate([one.weights for one in clouds]),
        scanners=np.concatenate([one.scanners for one in clouds]),
        sigma_m=clouds[0].sigma_m,
        across_m=clouds[0].across_m,
    )
