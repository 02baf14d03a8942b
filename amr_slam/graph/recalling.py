"""Loops after a long way: a piece of the way is recognized among all that drift lets it be.

One scan says too little where the robot may be tens of metres off: aisles and corridors look
alike. So the last metres of the way are matched as one cloud, by its signature (RDN) against those
of all finished submaps within the drift's ellipse. The place must stand out from every other one
in there, in whichever submap, and closes nothing until later pieces, which see other walls, have
said the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.evidence import Hypothesis, Rung, apart, objection
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.graph.closing import Closure, agree, doubtful, loop_edge
from amr_slam.graph.drift import Drift
from amr_slam.graph.posegraph import Edge
from amr_slam.graph.submaps import Submap, Submaps
from amr_slam.params import SlamParams
from amr_slam.registration import rdnm
from amr_slam.slam import examine, shortlist

_POINTS: Final = 1200
"""Of a piece, spread evenly over what it shows."""
_FINALISTS: Final = 3
"""Poses a submap that are refined with all of these."""
_NEAR_M: Final = 60.0
"""No place of a submap is farther than this from its middle."""
_SAME_M, _SAME_RAD = 1.0, 0.2
"""Places in two submaps may be one and the same when they differ by no more than this."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """A place where the piece fits."""

    submap: int
    place: Hypothesis
    pose: Pose2
    """map_from_base, by where the submap is thought to lie."""


class Recalling:
    """Seeks loops far off, and remembers those that wait for further witnesses."""

    def __init__(self, params: SlamParams) -> None:
        self._params = params
        self._waiting: list[Closure] = []
        self._closed: set[Closure] = set()
        self._sought_m = 0.0

    def seek(
        self, poses: Array, ways_m: Sequence[float], drift: Drift, submaps: Submaps
    ) -> list[Edge]:
        """The loops that the newest piece of the way closes, with those that it confirms.

        ``poses`` (n, 3), ``ways_m`` and ``drift``: of all nodes.
        """
        rules, way_m = self._params.closing, ways_m[-1]
        if way_m - self._sought_m < rules.recall_step_m or not self._far(drift, submaps):
            return []
        self._sought_m = way_m
        pose = Pose2.from_array(poses[-1])
        piece = submaps.piece(ways_m, rules.piece_m, rules.step_m)
        piece = piece.take(piece.even(_POINTS))
        found = list(self._fits(piece, pose, poses, drift, submaps))
        best = self._outstanding(found, drift, submaps, pose)
        if best is None:
            return []
        row = len(poses) - 1
        closure = Closure(
            row=row,
            submap=best.submap,
            pose=best.place.pose,
            edge=loop_edge(row, submaps.finished[best.submap], best.place),
        )
        agreeing = [*self._witnesses(closure, poses, ways_m, submaps), closure]
        self._waiting.append(closure)
        if len(agreeing) < rules.recall_witnesses:
            return []
        fresh = [one for one in agreeing if one not in self._closed]
        self._closed.update(fresh)
        return [one.edge for one in fresh]

    def _far(self, drift: Drift, submaps: Submaps) -> bool:
        """Whether any submap is out of reach for a single scan."""
        return bool(self._are_far(submaps.least(drift.ways_m)).any())

    def _are_far(self, ways_m: Array) -> NDArray[np.bool_]:
        rules = self._params.closing
        return rules.reach_m + rules.drift * ways_m > rules.most_m

    def _fits(
        self, piece: Cloud, pose: Pose2, poses: Array, drift: Drift, submaps: Submaps
    ) -> Iterator[_Found]:
        """Where the piece fits best, within the drift's reach."""
        params = self._params
        view = rdnm.views(submaps.local.target(pose), pose.translation[np.newaxis], params.rdnm)[0]
        rough: list[tuple[float, int, Array]] = []
        rivals = submaps.least(drift.ways_m) >= params.closing.rival_way_m
        rivals &= submaps.away_m(poses, pose) <= self._reaches_m(drift, submaps) + _NEAR_M
        for number in np.flatnonzero(rivals).tolist():
            here = self._candidates(view, pose, poses, drift, submaps.finished[number])
            rough += [(float(row[3]), number, row[:3]) for row in here]
        rough.sort(key=lambda one: one[:2])
        chosen: dict[int, list[Array]] = {}
        for _, number, row in rough[: params.closing.recall_candidates]:
            chosen.setdefault(number, []).append(row)
        for number, rows in chosen.items():
            target = submaps.target(number)
            best = shortlist(piece, target, np.array(rows), _FINALISTS, params)
            answer = examine(piece, target, best, len(rows), Rung.RESCUE, params)
            map_from_submap = submaps.finished[number].map_from_submap(poses)
            for place in answer.places:
                yield _Found(submap=number, place=place, pose=map_from_submap @ place.pose)

    def _reaches_m(self, drift: Drift, submaps: Submaps) -> Array:
        """(m,) how far each finished piece may lie from where it is thought to lie."""
        spread = drift.places_m2[[submap.middle for submap in submaps.finished]]
        widest_m2 = np.linalg.eigvalsh(spread)[:, -1]
        return np.asarray(np.sqrt(self._params.closing.beyond_d2 * widest_m2))

    def _candidates(
        self, view: Array, pose: Pose2, poses: Array, drift: Drift, submap: Submap
    ) -> Array:
        """(k, 4) rough poses in a submap and their costs. ``view``: the signature of the robot's
        place, in the axes of the map."""
        params, rules = self._params, self._params.closing
        map_from_submap = submap.map_from_submap(poses)
        spread = drift.places_m2[submap.middle]
        off = map_from_submap @ submap.places - pose.translation
        d2 = np.einsum("mi,ij,mj->m", off, np.linalg.inv(spread), off)
        here = d2 <= rules.beyond_d2
        turn_rad = rules.turn_rad + np.sqrt(rules.beyond_d2) * drift.headings_rad[submap.middle]
        rough = rdnm.rdnm(
            view,
            submap.signatures[here],
            submap.places[here],
            params.rdnm,
            best=params.absolute_candidates // 2,
            heading=(-map_from_submap.theta_rad, min(float(turn_rad), np.pi)),
        )
        rough[:, 2] += pose.theta_rad
        return rough

    def _outstanding(
        self, found: Sequence[_Found], drift: Drift, submaps: Submaps, pose: Pose2
    ) -> _Found | None:
        """The best place, if it would do for a rescue and no other place comes near it."""
        if not found:
            return None
        rules, bar = self._params.closing, self._params.rescue
        best = max(found, key=lambda one: one.place.score)
        submap = submaps.finished[best.submap]
        others = [one.place.score for one in found if _elsewhere(one, best)]
        off = best.pose.translation - pose.translation
        turn_rad = abs(wrap_angle(best.pose.theta_rad - pose.theta_rad))
        far_off = float(off @ np.linalg.inv(drift.places_m2[submap.middle]) @ off) > rules.beyond_d2
        turned = (
            turn_rad > rules.turn_rad + np.sqrt(rules.beyond_d2) * drift.headings_rad[submap.middle]
        )
        if (
            not self._are_far(drift.ways_m[submap.rows].min())
            or best.place.score - max(others, default=0.0) < bar.margin
            or objection(best.place, bar) is not None
            or doubtful(best.place, rules)
            or far_off
            or turned
        ):
            return None
        return best

    def _witnesses(
        self, closure: Closure, poses: Array, ways_m: Sequence[float], submaps: Submaps
    ) -> list[Closure]:
        """Earlier pieces that say the same, in whichever submap."""
        rules, here_m = self._params.closing, ways_m[closure.row]
        self._waiting = [
            one for one in self._waiting if here_m - ways_m[one.row] <= rules.recall_within_m
        ]
        said = submaps.finished[closure.submap].map_from_submap(poses) @ closure.pose
        witnesses = []
        for other in self._waiting:
            told = other.foretells(closure.row, poses)
            told = submaps.finished[other.submap].map_from_submap(poses) @ told
            if agree(told, said, *rules.recall_agree):
                witnesses.append(other)
        return witnesses


def _elsewhere(one: _Found, best: _Found) -> bool:
    """Not the same place. Two submaps know only about where they lie to each other."""
    if one.submap == best.submap:
        return apart(one.place.pose, best.place.pose)
    off = best.pose.inverse() @ one.pose
    return bool(np.hypot(off.x_m, off.y_m) > _SAME_M or abs(off.theta_rad) > _SAME_RAD)
