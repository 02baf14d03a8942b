"""The paper's two strategies, top to bottom: relative (algorithm 3) and absolute (algorithm 2).

X is the scan's cloud in the base frame, Y the map. A strategy's answer is data: the places found
with the evidence for each, and why nothing was accepted (:mod:`amr_slam.evidence`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.evidence import LEAST_WEIGHT, Answer, Rung, Verdict, assess, decide, unknown
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.registration import cpd, field, fit, icp, rdnm
from amr_slam.registration.alignment import Target
from amr_slam.registration.icp import Prior

__all__ = [
    "Answer",
    "Rung",
    "Verdict",
    "local_candidates",
    "slam_absolute",
    "slam_absolute_rungs",
    "slam_relative",
    "slam_rescue",
]

# Places that a quick rung examines: the best, and the second that it must stand out from.
_FIRST_LOOK = 2


def slam_relative(
    X: Cloud, Y: PointMap, prior: Prior, params: SlamParams, *, everywhere: bool = True
) -> Iterator[Answer]:
    """Algorithm 3: the pose near ``prior``, quickest strategy first.

    Yields one answer a rung, computed when it is asked for: who climbs stops at the first that is
    accepted. ``everywhere``: the last rungs look in the whole map, else around the prior.
    """
    expected = prior.target_from_source
    target = Y.target() if everywhere else Y.target(expected)

    rough = local_candidates(X, target, prior, params)
    found = shortlist(X, target, rough, _FIRST_LOOK, params, prior)
    yield examine(X, target, found, len(rough), Rung.RELATIVE, params, prior)

    drifted = cpd.align(X, Y.target(expected), expected, params.cpd).target_from_source
    # One start has no second place to stand out from: what drifted far is no local answer.
    near = drifted.distance_to(expected) <= params.rescue_m
    yield examine(X, target, poses_of([drifted] if near else []), 1, Rung.CPD, params)

    if everywhere:
        yield from slam_absolute_rungs(X, Y, params, np.array([expected.as_array()]))
    else:
        yield slam_rescue(X, Y, prior, params)


def slam_absolute(X: Cloud, Y: PointMap, params: SlamParams, also: Array | None = None) -> Answer:
    """Algorithm 2: the pose anywhere in the map. See :func:`slam_absolute_rungs`."""
    answer = unknown("nothing was tried", Rung.ABSOLUTE)
    for answer in slam_absolute_rungs(X, Y, params, also):
        if answer.verdict is Verdict.ACCEPTED:
            break
    return answer


def slam_absolute_rungs(
    X: Cloud, Y: PointMap, params: SlamParams, also: Array | None = None
) -> Iterator[Answer]:
    """Algorithm 2, and where it is not sure, its candidates joined with those of an exhaustive
    search: each source finds places that the other misses.

    ``also`` (k, 3): poses that are tried beside what is found, such as where earlier scans said
    that the robot may be.
    """
    target = Y.target()
    known = np.empty((0, 3)) if also is None else also
    objection = cannot_register(X, target)
    if objection is not None:
        yield unknown(objection, Rung.ABSOLUTE)
        return

    places, h_y = Y.signatures(params.grid_m, params.robot_radius_m, params.rdnm)
    h_x = rdnm.of_scan(X.points_m, params.rdnm)
    rough = rdnm.rdnm(h_x, h_y, places, params.rdnm, best=params.absolute_candidates)
    found = shortlist(X, target, np.concatenate([known, rough[:, :3]]), params.finalists, params)
    yield examine(X, target, found[:_FIRST_LOOK], len(rough), Rung.ABSOLUTE, params)

    if params.exhaustive.candidates:
        places = Y.places(params.exhaustive.spacing_m, params.robot_radius_m)
        more = field.search(X, Y.field(params.exhaustive), places, params.exhaustive)
        found = shortlist(X, target, np.concatenate([found, more[:, :3]]), params.finalists, params)
        yield examine(X, target, found, len(rough) + len(more), Rung.EXHAUSTIVE, params)


def slam_rescue(X: Cloud, Y: PointMap, prior: Prior, params: SlamParams) -> Answer:
    """Algorithm 2 with its grid "limited by an estimated position" (section 2.2): all headings
    around the prior, which then has no say any more."""
    centre = prior.target_from_source
    target = Y.target(centre)
    places = Y.places(params.grid_m, params.robot_radius_m)
    places = places[np.hypot(*(places - centre.translation).T) <= params.rescue_m]
    h_x = rdnm.of_scan(X.points_m, params.rdnm)
    h_y = rdnm.of_map(target, places, params.rdnm)
    rough = rdnm.rdnm(h_x, h_y, places, params.rdnm, best=params.absolute_candidates)
    found = shortlist(X, target, rough[:, :3], params.finalists, params)
    return examine(X, target, found, len(rough), Rung.RESCUE, params)


def local_candidates(X: Cloud, target: Target, prior: Prior, params: SlamParams) -> Array:
    """P_rel of algorithm 3, matched by RDNM: the rough poses (k, 3) in the prior's own window.

    The window is three standard deviations of the prior, never less than the paper's 6 points
    in 0.3 m; the prior itself is always among the candidates.
    """
    centre = prior.target_from_source
    covariance = np.linalg.inv(prior.information)
    reach = np.clip(3.0 * np.sqrt(np.diag(covariance)), params.window_min, params.window_max)
    offsets = window(reach[:2], params.local_spacing_m)
    places = centre.translation + offsets
    h_x = rdnm.of_scan(X.points_m, params.rdnm)
    h_y = rdnm.of_map(target, places, params.rdnm)
    heading = (centre.theta_rad, float(reach[2]))
    rough = rdnm.rdnm(
        h_x, h_y, places, params.rdnm, best=params.local_candidates, heading=heading
    )  # fmt: skip
    return np.concatenate([[centre.as_array()], rough[:, :3]])


def window(half_m: Array, spacing_m: float) -> Array:
    """Grid offsets (k, 2) over a rectangle of half sides ``half_m`` (2,), its centre included:
    ``spacing_m`` apart or more, 7 a side at most."""
    steps = [min(int(half / spacing_m), 3) for half in half_m]
    axes = [np.linspace(-half, half, 2 * n + 1) for half, n in zip(half_m, steps, strict=True)]
    x, y = np.meshgrid(*axes)
    return np.column_stack([x.ravel(), y.ravel()])


def shortlist(
    X: Cloud,
    target: Target,
    rough: Array,
    most: int,
    params: SlamParams,
    prior: Prior | None = None,
) -> Array:
    """The best ``most`` of rough poses (k, 3) that are distinct, best first: all are refined with
    a part of the scan. Fewer than that come back as they are."""
    if len(rough) <= most or cannot_register(X, target):
        return rough
    part = X.take(X.even(params.first_points))
    coarse = icp.refine(part, target, rough, params.icp, prior).poses
    scores = fit.scores(part, target, coarse, max(params.fit_m, 3.0 * X.across_m))
    return _best_distinct(coarse, scores, most)


def examine(
    X: Cloud,
    target: Target,
    poses: Array,
    candidates: int,
    rung: Rung,
    params: SlamParams,
    prior: Prior | None = None,
) -> Answer:
    """ICP with the whole scan from poses (k, 3), the scan's fit at each result, and the verdict;
    under noise, the best place once more by what its rays see.

    ``candidates``: how many rough poses these were chosen from."""
    objection = cannot_register(X, target)
    if objection is not None:
        return unknown(objection, rung)
    if not len(poses):
        return unknown("no candidate place", rung)
    alignments = [
        alignment
        for part, starts in _usable(X, target, poses_from(poses))
        for alignment in icp.align_many(part, target, starts, params.icp, prior)
    ]
    tried = [assess(X, target, alignment, params) for alignment in alignments]
    answer = decide(tried, candidates, rung, params)
    best, *others = answer.places
    ((part, _),) = _usable(X, target, [best.pose])
    exact = icp.polish(part, target, best.alignment, params.icp, prior)
    return replace(answer, places=(replace(best, alignment=exact), *others))


def _usable(X: Cloud, target: Target, poses: Sequence[Pose2]) -> list[tuple[Cloud, list[Pose2]]]:
    """What of the scan is to be registered, and from which poses: at each of them, the scan lies
    in other zones without landmarks."""
    if not target.zones:
        return [(X, list(poses))]
    return [
        (X.take(np.flatnonzero(fit.counts(target, pose @ X.points_m))), [pose]) for pose in poses
    ]


def _best_distinct(poses: Array, scores: Array, most: int) -> Array:
    """The best ``most`` of poses (k, 3) that lie 0.2 m or 4 degrees apart."""
    kept: list[Array] = []
    for pose in poses[np.argsort(-scores, kind="stable")]:
        near = [
            np.hypot(*(pose[:2] - other[:2])) < 0.2
            and abs(np.remainder(pose[2] - other[2] + np.pi, 2.0 * np.pi) - np.pi) < 0.07
            for other in kept
        ]
        if not any(near):
            kept.append(pose)
        if len(kept) == most:
            break
    return np.array(kept)


def cannot_register(X: Cloud, target: Target) -> str | None:
    """Why scan and map cannot be compared at all, or None."""
    if not len(X):
        return "the scan is empty"
    if not len(target):
        return "the map is empty"
    if X.weights.sum() < LEAST_WEIGHT:
        return "the scan shows less than half a metre of surface"
    return None


def poses_of(poses: Sequence[Pose2]) -> Array:
    """(k, 3) of poses."""
    return np.array([pose.as_array() for pose in poses]).reshape(-1, 3)


def poses_from(rows: Array) -> list[Pose2]:
    """Poses of (k, 3) rows."""
    return [Pose2.from_array(row) for row in rows]
