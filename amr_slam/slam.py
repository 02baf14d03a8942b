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
from amr_slam.params import SlamParams
from amr_slam.registration import cpd, icp
from amr_slam.registration.alignment import Alignment, Target
from amr_slam.registration.error import e_psr
from amr_slam.registration.icp import Prior
from amr_slam.registration.rdnm import as_pose, rdn, rdnm


class Rung(enum.StrEnum):
    """The steps of the ladder, quickest first."""

    RELATIVE = "rdnm+icp"
    CPD = "cpd+icp"
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


def slam_relative(X: Cloud, Y: PointMap, prior: Prior, params: SlamParams) -> Answer:
    """Algorithm 3: the pose near ``prior``; quickest strategy first, the next where it fails."""
    answer = unknown("the ladder has no rung")
    for answer in ladder(X, Y, prior, params):
        if answer.verdict is Verdict.ACCEPTED:
            return answer
    return answer


def ladder(X: Cloud, Y: PointMap, prior: Prior, params: SlamParams) -> Iterator[Answer]:
    """The answers of algorithm 3's rungs, computed as they are asked for."""
    target = Y.target(prior.target_from_source)

    rough = local_candidates(X, target, prior, params)
    yield refine_and_decide(X, Y, target, rough, params, Rung.RELATIVE, prior)

    drifted = cpd.align(X, target, prior.target_from_source, params.cpd).target_from_source
    yield refine_and_decide(X, Y, target, [drifted], params, Rung.CPD, prior)

    yield slam_absolute(X, Y, params)


def slam_absolute(X: Cloud, Y: PointMap, params: SlamParams) -> Answer:
    """Algorithm 2: the pose anywhere in the map, with no prior."""
    places, h_y = Y.signatures(params.grid_m, params.robot_radius_m, params.rdnm)
    h_x = rdn(X.points_m, np.zeros((1, 2)), 0.0, params.rdnm)[0]
    rough = rdnm(h_x, h_y, places, params.rdnm, best=params.absolute_candidates)
    return refine_and_decide(
        X, Y, Y.target(), [as_pose(r) for r in rough], params, Rung.ABSOLUTE, None
    )


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
    """Grid offsets (k, 2) over a rectangle of half sides ``half_m`` (2,), its centre included."""
    axes = [spacing_m * np.arange(-(h // spacing_m), h // spacing_m + 1) for h in half_m]
    x, y = np.meshgrid(*axes)
    return np.column_stack([x.ravel(), y.ravel()])


def refine_and_decide(
    X: Cloud,
    Y: PointMap,
    target: Target,
    rough: Sequence[Pose2],
    params: SlamParams,
    rung: Rung,
    prior: Prior | None,
) -> Answer:
    """ICP from every rough pose, the scan's fit at each result, and the verdict."""
    if not len(X) or not len(target):
        return unknown("the scan is empty" if not len(X) else "the map is empty", rung)
    if not rough:
        return unknown("no candidate place: the map shows no free space", rung)
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
    seen = Y.known(moved, target.tree)
    scale = max(params.fit_m, 3.0 * X.sigma_m)
    fit = 1.0 - np.minimum(seen.distance_m / scale, 1.0)
    on_wall = seen.distance_m <= 0.5 * scale
    return Hypothesis(
        alignment=alignment,
        score=float(fit.mean() - seen.free.mean()),
        inliers=float(on_wall.sum() / max(int(seen.known.sum()), 1)),
        known=float(seen.known.mean()),
        conflict=float(seen.free.mean()),
        e_psr_m=e_psr(moved, target.tree),
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
    """The verdict on the best hypothesis; without a prior it must also stand out."""
    best = tried[0]
    second = tried[1] if len(tried) > 1 else None
    margin = best.score - (max(second.score, 0.0) if second else 0.0)
    reason = objection(best, params)
    verdict = Verdict.UNKNOWN if reason else Verdict.ACCEPTED
    needed = params.absolute_margin if rung is Rung.ABSOLUTE else params.relative_margin
    if not reason and margin < needed:
        verdict = Verdict.AMBIGUOUS
        reason = f"a second place fits nearly as well (margin {margin:.2f} < {needed:.2f})"
    return Answer(
        verdict=verdict,
        rung=rung,
        candidates=candidates,
        best=best,
        second=second,
        margin=margin,
        reason=reason,
    )


def objection(hypothesis: Hypothesis, params: SlamParams) -> str | None:
    """Why a pose cannot be accepted on its own, or None."""
    if hypothesis.e_psr_m >= params.e_max_m:
        return f"registration error {hypothesis.e_psr_m:.2f} m >= {params.e_max_m:.2f} m"
    if not hypothesis.alignment.converged:
        return "the registration did not converge"
    if hypothesis.known < params.min_known:
        return f"only {hypothesis.known:.0%} of the scan lies where the map knows anything"
    if hypothesis.inliers < params.min_inliers:
        return f"only {hypothesis.inliers:.0%} of the known points lie on walls"
    if hypothesis.conflict > params.max_conflict:
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
