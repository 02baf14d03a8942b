"""Loops: a scan found again in an older submap, believed when a second one says the same.

A false loop is worse than none. So a scan is sought only where drift can have taken it, its place
there must stand out from all others within reach, and a closure counts once another scan, taken
elsewhere on the way, closes to the same submap with the same shift. Where drift can have taken
the robot farther than one scan can tell, pieces of the way are sought: :mod:`.recalling`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.evidence import Answer, Hypothesis, Rung, Verdict, unknown
from amr_slam.geometry import Array, Pose2, inverse_matrix, turned
from amr_slam.graph.drift import Drift
from amr_slam.graph.posegraph import Edge
from amr_slam.graph.submaps import Submap, Submaps
from amr_slam.params import ClosingParams, SlamParams
from amr_slam.registration import rdnm
from amr_slam.slam import examine, shortlist

_FLOOR: Final = np.diag([0.03**2, 0.03**2, 0.006**2])
"""Covariance that a closure has at least: both maps bend."""
_NOTHING: Final = 1e-4 * np.eye(3)
_PLACES: Final = 3
"""Submaps in which a scan is sought at most: those whose way passed nearest."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closure:
    """A scan found in a submap that it is no part of."""

    row: int
    """Of the scan's node."""
    submap: int
    """Number of the submap."""
    pose: Pose2
    """Of the scan, in the frame of the submap."""
    edge: Edge

    def foretells(self, row: int, poses: Array) -> Pose2:
        """The pose of another scan in the submap, by the way between the two."""
        way = Pose2.from_array(poses[self.row]).inverse() @ Pose2.from_array(poses[row])
        return self.pose @ way


class Closing:
    """Seeks loops near by, and remembers those that wait for a second witness."""

    def __init__(self, params: SlamParams) -> None:
        self._params = params
        self._waiting: list[Closure] = []
        self._closed: set[Closure] = set()

    def seek(
        self, cloud: Cloud, poses: Array, ways_m: Sequence[float], drift: Drift, submaps: Submaps
    ) -> list[Edge]:
        """The loops that the newest node closes, with the earlier closures that it confirms.

        ``poses`` (n, 3), ``ways_m`` and ``drift``: of all nodes.
        """
        rules = self._params.closing
        edges: list[Edge] = []
        pose = Pose2.from_array(poses[-1])
        near = self._within_reach(pose, poses, ways_m, drift, submaps)
        for number, expected, reach_m in near:
            closure = self._find(cloud, len(poses) - 1, number, submaps, expected, reach_m)
            if closure is None:
                continue
            others = self._witnesses(closure, poses, ways_m)
            self._waiting.append(closure)
            # What drift may have taken beyond the reach of the search needs more to speak for it.
            needed = rules.recall_witnesses - 1 if reach_m >= rules.most_m else 1
            if len(others) >= needed:
                agreeing = [*others[:needed], closure]
                edges += [one.edge for one in agreeing if one not in self._closed]
                self._closed.update(agreeing)
        return edges

    def _within_reach(
        self,
        pose: Pose2,
        poses: Array,
        ways_m: Sequence[float],
        drift: Drift,
        submaps: Submaps,
    ) -> Iterator[tuple[int, Pose2, float]]:
        """(number, pose expected in its frame, how far it may be off) of submaps to look in."""
        rules, near = self._params.closing, []
        reaches_m = rules.reach_m + rules.drift * submaps.least(drift.ways_m)
        reaches_m = np.minimum(reaches_m, rules.most_m)
        # No node of a piece is farther from its middle than the piece is long.
        seen_m = reaches_m + rules.beyond_m + rules.submap_m
        for number in np.flatnonzero(submaps.away_m(poses, pose) <= seen_m).tolist():
            submap, reach_m = submaps.finished[number], float(reaches_m[number])
            if ways_m[-1] - ways_m[submap.rows[-1]] < rules.least_way_m:
                continue
            expected = submap.map_from_submap(poses).inverse() @ pose
            distance_m, _ = submap.nearest(expected)
            if distance_m <= reach_m + rules.beyond_m:
                near.append((distance_m, number, expected, reach_m))
        for _, number, expected, reach_m in sorted(near, key=lambda one: one[:2])[:_PLACES]:
            yield number, expected, reach_m

    def _find(
        self,
        cloud: Cloud,
        row: int,
        number: int,
        submaps: Submaps,
        expected: Pose2,
        reach_m: float,
    ) -> Closure | None:
        rules, submap = self._params.closing, submaps.finished[number]
        answer = self._search(cloud, submaps, number, expected, max(reach_m, 1.0))
        best = answer.best
        if best is None or answer.verdict is not Verdict.ACCEPTED:
            return None
        off = expected.inverse() @ best.pose
        turn_rad = rules.turn_rad + rules.drift_radpm * reach_m
        far_m = reach_m + self._params.grid_m
        if np.hypot(off.x_m, off.y_m) > far_m or abs(off.theta_rad) > turn_rad:
            return None
        if best.known < rules.known or doubtful(best, rules):
            return None
        return Closure(
            row=row,
            submap=number,
            pose=best.pose,
            edge=loop_edge(row, submap, best),
        )

    def _search(
        self, cloud: Cloud, submaps: Submaps, number: int, expected: Pose2, reach_m: float
    ) -> Answer:
        """The rescue of :func:`amr_slam.slam.slam_rescue` in a finished submap. It takes no side:
        the expected pose says where to look, not what to find."""
        submap, params = submaps.finished[number], self._params
        here = np.hypot(*(submap.places - expected.translation).T) <= reach_m
        if not here.any():
            return unknown("no place within reach", Rung.RESCUE)
        rough = rdnm.rdnm(
            rdnm.of_scan(cloud.points_m, params.rdnm),
            submap.signatures[here],
            submap.places[here],
            params.rdnm,
            best=params.absolute_candidates,
        )
        target = submaps.target(number)
        found = shortlist(cloud, target, rough[:, :3], params.finalists, params)
        return examine(cloud, target, found, len(rough), Rung.RESCUE, params)

    def _witnesses(self, closure: Closure, poses: Array, ways_m: Sequence[float]) -> list[Closure]:
        """The earlier closures that say the same, newest first."""
        rules = self._params.closing
        nearest_m, farthest_m = rules.apart_m
        here_m = ways_m[closure.row]
        self._waiting = [one for one in self._waiting if here_m - ways_m[one.row] <= farthest_m]
        return [
            other
            for other in reversed(self._waiting)
            if other.submap == closure.submap
            and here_m - ways_m[other.row] >= nearest_m
            and agree(
                other.foretells(closure.row, poses), closure.pose, rules.agree_m, rules.agree_rad
            )
        ]


def agree(one: Pose2, other: Pose2, within_m: float, within_rad: float) -> bool:
    """Whether two poses are the same."""
    off = other.inverse() @ one
    return bool(np.hypot(off.x_m, off.y_m) <= within_m and abs(off.theta_rad) <= within_rad)


def doubtful(found: Hypothesis, rules: ClosingParams) -> bool:
    """Whether walls are missing or too many, the fit is poor, or the place is a corridor, where the
    position along its worst direction is known too little."""
    weakest = float(np.linalg.eigvalsh(found.alignment.information[:2, :2])[0])
    return (
        found.conflict > rules.conflict or found.score < rules.score or weakest < rules.weak_m**-2
    )


def loop_edge(row: int, submap: Submap, found: Hypothesis) -> Edge:
    """From the submap's nearest node to the scan that was found in it."""
    _, number = submap.nearest(found.pose)
    anchor = Pose2.from_array(submap.poses[number])
    covariance = inverse_matrix(found.alignment.information + _NOTHING)
    return Edge(
        start=int(submap.rows[number]),
        end=row,
        delta=anchor.inverse() @ found.pose,
        information=inverse_matrix(turned(covariance, anchor.rotation.T) + _FLOOR),
        loop=True,
    )
