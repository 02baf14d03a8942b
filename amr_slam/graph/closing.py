"""Loops: a scan found again in an older submap, believed when a second one says the same.

A false loop is worse than none. So a scan is sought only where drift can have taken it, its place
there must stand out from all others within reach, and a closure counts once another scan, taken
elsewhere on the way, closes to the same submap with the same shift.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.evidence import Hypothesis, Verdict
from amr_slam.geometry import Array, Pose2, inverse_matrix, turned
from amr_slam.graph.posegraph import Edge
from amr_slam.graph.submaps import Submap
from amr_slam.params import SlamParams
from amr_slam.registration.icp import Prior
from amr_slam.slam import slam_rescue

_FLOOR: Final = np.diag([0.03**2, 0.03**2, 0.006**2])
"""Covariance that a closure has at least: both maps bend."""
_NOTHING: Final = 1e-4 * np.eye(3)
_PLACES: Final = 3
"""Submaps in which a scan is sought at most: those whose way passed nearest."""
_BEYOND_M: Final = 2.0
"""A scan may be found this far from where the submap's own scans were taken."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closure:
    """A scan found in a submap that it is no part of."""

    row: int
    """Of the scan's node."""
    submap: int
    """Number of the submap."""
    pose: Pose2
    """Of the scan, in the frame of the submap."""
    shift: Pose2
    """What takes the way's poses to the submap's frame, by this closure."""
    edge: Edge


class Closing:
    """Seeks loops, and remembers those that wait for a second witness."""

    def __init__(self, params: SlamParams) -> None:
        self._params = params
        self._waiting: list[Closure] = []
        self._sought_m = -np.inf
        self._closed_m = 0.0

    def seek(
        self, cloud: Cloud, poses: Array, ways_m: Sequence[float], submaps: Sequence[Submap]
    ) -> list[Edge]:
        """The loops that the newest node closes, with the earlier closures that it confirms.

        ``poses`` (n, 3) and ``ways_m``: of all nodes; ``submaps``: all that are finished.
        """
        way_m, rules = ways_m[-1], self._params.closing
        if way_m - self._sought_m < rules.step_m:
            return []
        self._sought_m = way_m
        edges: list[Edge] = []
        pose = Pose2.from_array(poses[-1])
        for number, expected, reach_m in self._within_reach(pose, poses, ways_m, submaps):
            closure = self._find(cloud, len(poses) - 1, pose, number, submaps, expected, reach_m)
            if closure is None:
                continue
            witness = self._witness(closure, ways_m)
            self._waiting.append(closure)
            if witness is not None:
                edges += [witness.edge, closure.edge]
        if edges:
            # What waits was found before the poses moved: its shift is of no use any more.
            self._waiting.clear()
            self._closed_m = way_m
        return edges

    def _within_reach(
        self, pose: Pose2, poses: Array, ways_m: Sequence[float], submaps: Sequence[Submap]
    ) -> Iterator[tuple[int, Pose2, float]]:
        """(number, pose expected in its frame, how far it may be off) of submaps to look in."""
        rules, near = self._params.closing, []
        for number, submap in enumerate(submaps):
            left_m = ways_m[submap.rows[-1]]
            if ways_m[-1] - left_m < rules.least_way_m:
                continue
            drifted_m = rules.drift * (ways_m[-1] - max(left_m, self._closed_m))
            reach_m = min(rules.reach_m + drifted_m, rules.most_m)
            expected = submap.map_from_submap(poses).inverse() @ pose
            distance_m, _ = submap.nearest(expected)
            if distance_m <= reach_m + _BEYOND_M:
                near.append((distance_m, number, expected, reach_m))
        for _, number, expected, reach_m in sorted(near, key=lambda one: one[:2])[:_PLACES]:
            yield number, expected, reach_m

    def _find(
        self,
        cloud: Cloud,
        row: int,
        pose: Pose2,
        number: int,
        submaps: Sequence[Submap],
        expected: Pose2,
        reach_m: float,
    ) -> Closure | None:
        rules, submap = self._params.closing, submaps[number]
        # The search takes no side: the prior says where to look, not what to find.
        prior = Prior(target_from_source=expected, information=np.zeros((3, 3)))
        params = replace(self._params, rescue_m=max(reach_m, 1.0))
        answer = slam_rescue(cloud, submap.map, prior, params)
        best = answer.best
        if best is None or answer.verdict is not Verdict.ACCEPTED:
            return None
        turn_rad = abs((expected.inverse() @ best.pose).theta_rad)
        if best.known < rules.known or turn_rad > rules.turn_rad + rules.drift_radpm * reach_m:
            return None
        if float(np.linalg.eigvalsh(best.alignment.information[:2, :2])[0]) < rules.weak_m**-2:
            return None
        return Closure(
            row=row,
            submap=number,
            pose=best.pose,
            shift=best.pose @ pose.inverse(),
            edge=_edge(row, submap, best),
        )

    def _witness(self, closure: Closure, ways_m: Sequence[float]) -> Closure | None:
        """The newest earlier closure that says the same."""
        rules = self._params.closing
        nearest_m, farthest_m = rules.apart_m
        for other in reversed(self._waiting):
            apart_m = ways_m[closure.row] - ways_m[other.row]
            if other.submap != closure.submap or not nearest_m <= apart_m <= farthest_m:
                continue
            # Shifts are compared where the robot is: a turn moves what is far away.
            off = (other.shift @ closure.shift.inverse() @ closure.pose).inverse() @ closure.pose
            if (
                np.hypot(off.x_m, off.y_m) <= rules.agree_m
                and abs(off.theta_rad) <= rules.agree_rad
            ):
                return other
        return None


def _edge(row: int, submap: Submap, found: Hypothesis) -> Edge:
    """From the submap's nearest node to the scan that was found in it."""
    _, number = submap.nearest(found.pose)
    anchor = submap.poses[number]
    covariance = inverse_matrix(found.alignment.information + _NOTHING)
    return Edge(
        start=submap.rows[number],
        end=row,
        delta=anchor.inverse() @ found.pose,
        information=inverse_matrix(turned(covariance, anchor.rotation.T) + _FLOOR),
        loop=True,
    )
