"""The paper's two strategies, top to bottom: relative (algorithm 3) and absolute (algorithm 2).

X is the scan's cloud in the base frame, Y the map. A strategy's answer is data: the pose if there
is one, the evidence for it, the second best place, and why nothing was accepted.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.params import Acceptance, SlamParams
from amr_slam.registration import cpd, icp
from amr_slam.registration.alignment import Alignment, Target
from amr_slam.registration.error import mean_below, nearest
from amr_slam.registration.icp import Prior
from amr_slam.registration.rdnm import as_pose, rdn, rdnm

# Half a metre of surface, in points of full weight: a post or a speck fits anywhere.
_LEAST_WEIGHT = 10.0


class Rung(enum.StrEnum):
    """The steps of the ladder, quickest first."""

    RELATIVE = "rdnm+icp"
    CPD = "cpd+icp"
    RESCUE = "rescue"
    ABSOLUTE = "absolute"


class Verdict(enum.StrEnum):
    """What a strategy says of its best pose."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """One refined pose and how well the whole scan fits there."""

    alignment: Alignment
    score: float
    """Mean fit of the scan's points, 1 on a wall to 0 off it, less the contradicting share."""
    inliers: float
    """Share of the points in known places that lie on walls."""
    known: float
    """Share of the points that lie where the map knows anything."""
    conflict: float
    """Share of the points that stand where the map saw free space."""
    e_psr_m: float
    """Registration error, eq. 1."""

    @property
    def pose(self) -> Pose2:
        return self.alignment.target_from_source


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """What a strategy found, evidence included."""

    verdict: Verdict
    rung: Rung
    candidates: int
    """Poses that were refined."""
    best: Hypothesis | None
    second: Hypothesis | None
    """The best place that is distinct from ``best``."""
    margin: float
    """Score of the best over the second (over 0 where there is none)."""
    reason: str | None = None
    """Why nothing was accepted."""


def slam_relative(
    X: Cloud, Y: PointMap, prior: Prior, params: SlamParams, *, everywhere: bool = True
) -> Iterator[Answer]:
    """Algorithm 3: the pose near ``prior``, quickest strategy first.

    Yields one answer a rung, computed when it is asked for: who climbs stops at the first that is
    accepted. ``everywhere``: the last rung looks in the whole map, else around the prior.
    """
    target = Y.target(prior.target_from_source)

    rough = local_candidates(X, target, prior, params)
    yield refine_and_decide(X, Y, target, rough, params, Rung.RELATIVE, prior)

    drifted = cpd.align(X, target, prior.target_from_source, params.cpd).target_from_source
    # One start has no second place to stand out from: what drifted far is no local answer.
    near = drifted.distance_to(prior.target_from_source) <= params.rescue_m
    yield refine_and_decide(X, Y, target, [drifted] if near else [], params, Rung.CPD)

    yield slam_absolute(X, Y, params) if everywhere else slam_rescue(X, Y, prior, params)


def slam_absolute(X: Cloud, Y: PointMap, params: SlamParams) -> Answer:
    """Algorithm 2: the pose anywhere in the map."""
    places, h_y = Y.signatures(params.grid_m, params.robot_radius_m, params.rdnm)
    h_x = rdn(X.points_m, np.zeros((1, 2)), 0.0, params.rdnm)[0]
    rough = rdnm(h_x, h_y, places, params.rdnm, best=params.absolute_candidates)
    poses = [as_pose(r) for r in rough]
    return refine_and_decide(X, Y, Y.target(), poses, params, Rung.ABSOLUTE)


def slam_rescue(X: Cloud, Y: PointMap, prior: Prior, params: SlamParams) -> Answer:
    """Algorithm 2 with its grid "limited by an estimated position" (section 2.2): all headings
    around the prior, which then has no say any more."""
    centre = prior.target_from_source
    target = Y.target(centre)
    places = Y.places(params.grid_m, params.robot_radius_m)
    places = places[np.hypot(*(places - centre.translation).T) <= params.rescue_m]
    h_x = rdn(X.points_m, np.zeros((1, 2)), 0.0, params.rdnm)[0]
    h_y = rdn(target.points_m, places, target.spacing_m, params.rdnm)
    rough = rdnm(h_x, h_y, places, params.rdnm, best=params.absolute_candidates)
    return refine_and_decide(X, Y, target, [as_pose(r) for r in rough], params, Rung.RESCUE)


def local_candidates(X: Cloud, target: Target, prior: Prior, params: SlamParams) -> list[Pose2]:
    """P_rel of algorithm 3, matched by RDNM: the rough poses inside the prior's own window.

    The window is three standard deviations of the prior, never less than the paper's 6 points
    in 0.3 m; the prior itself is always among the candidates.
    """
    centre = prior.target_from_source
    covariance = np.linalg.inv(prior.information)
    reach = np.clip(3.0 * np.sqrt(np.diag(covariance)), params.window_min, params.window_max)
    offsets = _window(reach[:2], params.local_spacing_m)
    places = centre.translation + offsets
    h_x = rdn(X.points_m, np.zeros((1, 2)), 0.0, params.rdnm)[0]
    h_y = rdn(target.points_m, places, target.spacing_m, params.rdnm)
    heading = (centre.theta_rad, float(reach[2]))
    rough = rdnm(h_x, h_y, places, params.rdnm, best=params.local_candidates, heading=heading)
    return [centre, *(as_pose(r) for r in rough)]


def _window(half_m: Array, spacing_m: float) -> Array:
    """Grid offsets (k, 2) over a rectangle of half sides ``half_m`` (2,), its centre included:
    ``spacing_m`` apart or more, 7 a side at most."""
    steps = [min(int(half / spacing_m), 3) for half in half_m]
    axes = [np.linspace(-half, half, 2 * n + 1) for half, n in zip(half_m, steps, strict=True)]
    x, y = np.meshgrid(*axes)
    return np.column_stack([x.ravel(), y.ravel()])


def refine_and_decide(
    X: Cloud,
    Y: PointMap,
    target: Target,
    rough: Sequence[Pose2],
    params: SlamParams,
    rung: Rung,
    prior: Prior | None = None,
) -> Answer:
    """ICP from every rough pose, the scan's fit at each result, and the verdict."""
    if not len(X) or not len(target):
        return unknown("the scan is empty" if not len(X) else "the map is empty", rung)
    if X.weights.sum() < _LEAST_WEIGHT:
        return unknown("the scan shows less than half a metre of surface", rung)
    if not rough:
        return unknown("no candidate place", rung)
    alignments = icp.align_many(X, target, rough, params.icp, prior)
    tried = distinct(sorted((assess(X, Y, target, a, params) for a in alignments), key=_rank))
    return decide(tried, len(rough), rung, params)


def _rank(hypothesis: Hypothesis) -> float:
    return -hypothesis.score


def assess(
    X: Cloud, Y: PointMap, target: Target, alignment: Alignment, params: SlamParams
) -> Hypothesis:
    """How well the whole scan fits at one refined pose."""
    moved = alignment.target_from_source @ X.points_m
    distance = nearest(moved, target.tree)
    seen = Y.known(moved, distance)
    scale = max(params.fit_m, 3.0 * X.sigma_m)
    fit = 1.0 - np.minimum(distance / scale, 1.0)
    share = X.weights / X.weights.sum()
    known = float(share @ seen.known)
    on_wall = float(share @ (distance <= 0.5 * scale))
    return Hypothesis(
        alignment=alignment,
        score=float(share @ fit - share @ seen.free),
        inliers=min(on_wall / max(known, 1e-9), 1.0),
        known=known,
        conflict=float(share @ seen.free),
        e_psr_m=mean_below(distance),
    )


def distinct(ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The best of each place: results 0.3 m or 0.1 rad apart are different places."""
    kept: list[Hypothesis] = []
    for one in ranked:
        if all(_apart(one.pose, other.pose) for other in kept):
            kept.append(one)
    return kept


def _apart(a: Pose2, b: Pose2) -> bool:
    return a.distance_to(b) > 0.3 or abs((a.inverse() @ b).theta_rad) > 0.1


def decide(tried: Sequence[Hypothesis], candidates: int, rung: Rung, params: SlamParams) -> Answer:
    """The verdict on the best hypothesis: it must fit, and stand out from the second place."""
    best = tried[0]
    second = tried[1] if len(tried) > 1 else None
    margin = best.score - (max(second.score, 0.0) if second else 0.0)
    bar = {
        Rung.RELATIVE: params.relative,
        Rung.CPD: params.rescue,  # it may have drifted as far as a search would look
        Rung.RESCUE: params.rescue,
        Rung.ABSOLUTE: params.absolute,
    }[rung]
    reason = objection(best, bar)
    verdict = Verdict.UNKNOWN if reason else Verdict.ACCEPTED
    if not reason and margin < bar.margin:
        verdict = Verdict.AMBIGUOUS
        reason = f"a second place fits nearly as well (margin {margin:.2f} < {bar.margin:.2f})"
    return Answer(
        verdict=verdict,
        rung=rung,
        candidates=candidates,
        best=best,
        second=second,
        margin=margin,
        reason=reason,
    )


def objection(hypothesis: Hypothesis, bar: Acceptance) -> str | None:
    """Why a pose cannot be accepted on its own, or None."""
    if hypothesis.e_psr_m >= bar.e_max_m:
        return f"registration error {hypothesis.e_psr_m:.2f} m >= {bar.e_max_m:.2f} m"
    if hypothesis.known < bar.known:
        return f"only {hypothesis.known:.0%} of the scan lies where the map knows anything"
    if hypothesis.inliers < bar.inliers:
        return f"only {hypothesis.inliers:.0%} of the known points lie on walls"
    if hypothesis.conflict > bar.conflict:
        return f"{hypothesis.conflict:.0%} of the scan stands where the map saw free space"
    return None


def unknown(reason: str, rung: Rung = Rung.RELATIVE) -> Answer:
    """No pose, with its reason."""
    return Answer(
        verdict=Verdict.UNKNOWN,
        rung=rung,
        candidates=0,
        best=None,
        second=None,
        margin=0.0,
        reason=reason,
    )
