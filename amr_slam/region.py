"""The pose within a region that somebody named: a searched ``set_pose``.

A person's word is a prior, no proof. Within the region the scan must fit as well as anywhere that
is believed from one scan, and no other place of the map may fit it better by a margin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.evidence import Answer, Hypothesis, Rung, Verdict, apart, unknown
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.registration import field, rdnm
from amr_slam.slam import cannot_register, examine, shortlist, slam_absolute_rungs, window

# ICP may end a little beyond where it was started.
_SLACK_M = 0.5
_SLACK_RAD = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """Where somebody says that the robot is."""

    map_from_base: Pose2
    radius_m: float
    """The robot is at most this far from there ..."""
    heading_rad: float
    """... and turned by at most this much against it."""

    def holds(self, pose: Pose2) -> bool:
        """Whether a found pose is one of the region's."""
        turn = wrap_angle(pose.theta_rad - self.map_from_base.theta_rad)
        return (
            pose.distance_to(self.map_from_base) <= self.radius_m + _SLACK_M
            and abs(turn) <= self.heading_rad + _SLACK_RAD
        )


def slam_region(X: Cloud, Y: PointMap, region: Region, params: SlamParams) -> Iterator[Answer]:
    """What is found within the region; and if that is accepted, the same answer again once the
    rest of the map has been searched for a place that fits better."""
    found = _within(X, Y, region, params)
    yield found
    if found.verdict is Verdict.ACCEPTED and found.best is not None:
        yield _unless_better_elsewhere(X, Y, found, found.best, params)


def _within(X: Cloud, Y: PointMap, region: Region, params: SlamParams) -> Answer:
    target = Y.target()
    objection = cannot_register(X, target)
    if objection is not None:
        return unknown(objection, Rung.REGION)
    rough = _rough(X, Y, region, params)
    found = shortlist(X, target, rough, params.finalists, params)
    answer = examine(X, target, found, len(rough), Rung.REGION, params)
    best = answer.best
    if answer.verdict is Verdict.ACCEPTED and best is not None and not region.holds(best.pose):
        reason = f"the nearest place that fits is {_told(best.pose)}, outside the region"
        return replace(answer, verdict=Verdict.UNKNOWN, reason=reason)
    return answer


def _rough(X: Cloud, Y: PointMap, region: Region, params: SlamParams) -> Array:
    """(k, 3) poses to refine, from both searches, the region's own centre first."""
    centre = region.map_from_base
    places = np.concatenate(
        [
            centre.translation + window(np.full(2, region.radius_m), params.local_spacing_m),
            Y.places(params.grid_m, params.robot_radius_m),
        ]
    )
    places = _near(places, region)
    h_x = rdnm.of_scan(X.points_m, params.rdnm)
    h_y = rdnm.of_map(Y.target(), places, params.rdnm)
    heading = (centre.theta_rad, region.heading_rad)
    matched = rdnm.rdnm(
        h_x, h_y, places, params.rdnm, best=params.absolute_candidates, heading=heading
    )  # fmt: skip
    rough = [centre.as_array()[None, :], matched[:, :3]]
    if params.exhaustive.candidates:
        places = _near(Y.places(params.exhaustive.spacing_m, params.robot_radius_m), region)
        more = field.search(X, Y.field(params.exhaustive), places, params.exhaustive)[:, :3]
        turns = np.abs(np.remainder(more[:, 2] - centre.theta_rad + np.pi, 2.0 * np.pi) - np.pi)
        rough.append(more[turns <= region.heading_rad])
    return np.concatenate(rough)


def _near(places: Array, region: Region) -> Array:
    off_m = np.hypot(*(places - region.map_from_base.translation).T)
    return np.asarray(places[off_m <= region.radius_m])


def _unless_better_elsewhere(
    X: Cloud, Y: PointMap, found: Answer, best: Hypothesis, params: SlamParams
) -> Answer:
    others: list[Hypothesis] = []
    for answer in slam_absolute_rungs(X, Y, params, np.array([best.pose.as_array()])):
        others = [place for place in answer.places if apart(place.pose, best.pose)]
    better = max(others, key=lambda place: place.score, default=best)
    if better.score < best.score + params.rescue.margin:
        return found
    return replace(
        found,
        verdict=Verdict.UNKNOWN,
        reason=f"the scan fits better outside the region, {_told(better.pose)}",
    )


def _told(pose: Pose2) -> str:
    return f"at x {pose.x_m:.2f} m, y {pose.y_m:.2f} m, theta {pose.theta_rad:.2f} rad"
