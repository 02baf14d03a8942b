"""What speaks for a pose: how the whole scan fits there, and the verdict on the best place.

One look at a scan is a witness, not a proof: halls repeat themselves, people stand in the way. So
everything that was found is kept as data, the places that were not chosen included.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Pose2
from amr_slam.params import Acceptance, Plausibility, SlamParams
from amr_slam.registration import fit
from amr_slam.registration.alignment import Alignment, Target
from amr_slam.registration.error import mean_below

# Points this near to a wall lie in a known place.
_REACH_M = 0.3

# A scanner that sees less of the scan's surface than this is too little of a witness.
_WITNESS = 0.2
# Of a scan that lies in zones without landmarks with more than this, the rest is no witness.
MOST_HIDDEN = 0.8
# Half a metre of surface, in points of full weight: a post or a speck fits anywhere.
LEAST_WEIGHT = 10.0
# What a beam through a wall takes off the score. A part only: glass and railings are mapped, too.
_PASSING = 0.3


class Rung(enum.StrEnum):
    """The steps of the ladder, quickest first."""

    RELATIVE = "rdnm+icp"
    CPD = "cpd+icp"
    RESCUE = "rescue"
    ABSOLUTE = "absolute"
    EXHAUSTIVE = "exhaustive"
    REGION = "region"
    """No step of the ladder: sought where somebody says."""


class Verdict(enum.StrEnum):
    """What a strategy says of its best pose."""

    ACCEPTED = "accepted"
    AMBIGUOUS = "ambiguous"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """One refined pose and how well the whole scan fits there. Shares are of the scan's surface."""

    alignment: Alignment
    score: float
    """Mean fit of the scan's points, 1 on a wall to 0 off it, less the share in conflict and a
    part of that which passed walls."""
    inliers: float
    """Share of the points in known places that lie on walls."""
    known: float
    """Share of the points that lie where the map knows anything."""
    conflict: float
    """Share of the points that stand where the map saw free space."""
    passes: float
    """Share of the beams that went through a wall of the map before they ended."""
    agreeing: float
    """Share of the beams that end where the map's first wall is; with two scanners, which are two
    witnesses, that of the one that agrees less."""
    e_psr_m: float
    """Registration error, eq. 1."""
    hidden: float = 0.0
    """Share of the points in zones where nothing is a landmark: they say nothing here."""

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
    places: tuple[Hypothesis, ...] = ()
    """The distinct places that were found, best first."""
    odds: tuple[float, ...] = ()
    """How probable each of them is; what is missing to 1 is for a place that is none of them."""
    margin: float = 0.0
    """Score of the best place over the second (over 0 where there is none)."""
    reason: str | None = None
    """Why nothing was accepted."""
    elapsed_s: float = field(default=0.0, compare=False)
    """Processor's time that the rung took; the one thing here that another run changes."""

    @property
    def best(self) -> Hypothesis | None:
        return self.places[0] if self.places else None

    @property
    def second(self) -> Hypothesis | None:
        return self.places[1] if len(self.places) > 1 else None


def assess(X: Cloud, target: Target, alignment: Alignment, params: SlamParams) -> Hypothesis:
    """How well the whole scan fits at one refined pose.

    What lies in a zone without landmarks speaks neither for the pose nor against it. The score is
    of the whole scan nevertheless: no place gains by hiding what contradicts it in a zone.
    """
    pose = alignment.target_from_source
    moved = pose @ X.points_m
    distance = fit.distances(target, moved)
    reach = max(params.fit_m, 3.0 * X.across_m)
    free = target.lookup.seen_free(moved) & (distance > fit.clearance(X))
    whole = X.weights / X.weights.sum()
    counts = fit.counts(target, moved)
    share = whole * counts
    seen = max(float(share.sum()), 1e-9)
    known = float(share @ (free | (distance <= max(_REACH_M, 3.0 * X.across_m))))
    conflict = float(share @ free)
    on_wall = float(share @ (distance <= 0.5 * reach))
    longer = fit.beyond_walls(X, target, pose)
    tolerance = max(params.fit_m, 2.5 * X.sigma_m)
    passes = float(whole @ (longer > tolerance))
    fits = float(share @ (1.0 - np.minimum(distance / reach, 1.0)))
    return Hypothesis(
        alignment=alignment,
        score=fits - conflict - _PASSING * passes,
        inliers=min(on_wall / max(known, 1e-9), 1.0),
        known=known / seen,
        conflict=conflict / seen,
        passes=passes,
        agreeing=least_witness(X, np.abs(longer) <= tolerance),
        e_psr_m=mean_below(distance[counts]),
        hidden=hidden(X, counts),
    )


def hidden(X: Cloud, counts: NDArray[np.bool_]) -> float:
    """Share of a scan, not empty, that lies where nothing counts; 1 where too little is left."""
    left = float(X.weights @ counts)
    return 1.0 - left / float(X.weights.sum()) if left >= LEAST_WEIGHT else 1.0


def least_witness(X: Cloud, agrees: NDArray[np.bool_]) -> float:
    """Least share of a scanner's surface that agrees, of those that saw a fair part of it."""
    seen = np.bincount(X.scanners, X.weights)
    agreed = np.bincount(X.scanners, X.weights * agrees, len(seen))
    heard = seen >= _WITNESS * seen.sum()
    return float(np.min(agreed[heard] / seen[heard]))


def distinct(ranked: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The best of each place: results 0.3 m or 0.1 rad apart are different places."""
    kept: list[Hypothesis] = []
    for one in ranked:
        if all(apart(one.pose, other.pose) for other in kept):
            kept.append(one)
    return tuple(kept)


def apart(a: Pose2, b: Pose2) -> bool:
    """Whether two poses are different places."""
    return a.distance_to(b) > 0.3 or abs((a.inverse() @ b).theta_rad) > 0.1


def decide(tried: Sequence[Hypothesis], candidates: int, rung: Rung, params: SlamParams) -> Answer:
    """The verdict on the best hypothesis: it must fit, and stand out from the second place."""
    places = distinct(sorted(tried, key=lambda one: -one.score))
    best = places[0]
    margin = best.score - (max(places[1].score, 0.0) if len(places) > 1 else 0.0)
    odds = odds_of(places, params.plausibility)
    bar = {
        Rung.RELATIVE: params.relative,
        Rung.CPD: params.rescue,  # it may have drifted as far as a search would look
        Rung.RESCUE: params.rescue,
        Rung.ABSOLUTE: params.absolute,
        Rung.EXHAUSTIVE: params.absolute,
        Rung.REGION: params.rescue,
    }[rung]
    reason = objection(best, bar)
    verdict = Verdict.UNKNOWN if reason else Verdict.ACCEPTED
    if not reason and margin < bar.margin:
        verdict = Verdict.AMBIGUOUS
        reason = f"a second place fits nearly as well (margin {margin:.2f} < {bar.margin:.2f})"
    least = {
        Rung.ABSOLUTE: params.plausibility.sure,
        Rung.EXHAUSTIVE: params.plausibility.accept,
        Rung.REGION: params.plausibility.accept,
    }.get(rung, 0.0)
    probable = plausibility(best, margin, params.plausibility)
    if not reason and probable < least:
        verdict, reason = _doubt(probable, odds, least)
    return Answer(
        verdict=verdict,
        rung=rung,
        candidates=candidates,
        places=places,
        odds=odds,
        margin=margin,
        reason=reason,
    )


def _doubt(probable: float, odds: Sequence[float], least: float) -> tuple[Verdict, str]:
    """What to call a best place that is not probable enough, and why."""
    likely = [p for p in odds if p >= 0.1 * odds[0]]
    if len(likely) > 1 and sum(odds) >= 0.5:
        shares = ", ".join(f"{p:.0%}" for p in likely)
        return Verdict.AMBIGUOUS, f"{len(likely)} places fit alike (odds {shares})"
    return Verdict.UNKNOWN, f"the best place is right by {probable:.2%} only (< {least:.2%})"


def plausibility(best: Hypothesis, margin: float, params: Plausibility) -> float:
    """Probability that the best place is the right one, given its lead over the second."""
    evidence = (
        params.bias
        + params.margin * margin
        + params.agreeing * best.agreeing
        + params.passes * best.passes
    )
    return 1.0 / (1.0 + math.exp(-min(max(evidence, -50.0), 50.0)))


def odds_of(places: Sequence[Hypothesis], params: Plausibility) -> tuple[float, ...]:
    """How probable each of the places (best first, not empty) is; they sum to 1 at most.

    In all as probable as the best would be without a rival; among themselves they share it by
    their scores. What is left is for a place that is none of them.
    """
    best = places[0]
    fits = plausibility(best, max(best.score, 0.0), params)
    ratios = [math.exp(params.margin * (place.score - best.score)) for place in places]
    return tuple(fits * ratio / sum(ratios) for ratio in ratios)


def objection(hypothesis: Hypothesis, bar: Acceptance) -> str | None:
    """Why a pose cannot be accepted on its own, or None."""
    if hypothesis.hidden > MOST_HIDDEN:
        return f"{hypothesis.hidden:.0%} of the scan lies in no-localize zones"
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
    return Answer(verdict=Verdict.UNKNOWN, rung=rung, candidates=0, reason=reason)
