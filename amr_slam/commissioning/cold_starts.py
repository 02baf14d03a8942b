"""The robot is switched on and knows nothing of where it is: what the global search makes of it."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from amr_slam.commissioning.places import thinned
from amr_slam.commissioning.settings import ReportParams
from amr_slam.commissioning.viewing import Eye, seen
from amr_slam.engine import SlamEngine
from amr_slam.evidence import Answer, Verdict, apart
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.registration import rdnm
from amr_slam.registration.rdnm import RdnmParams
from amr_slam.slam_request import SlamRequest

Progress = Callable[[float], None]
"""Told the share that is done."""

# Signatures for finding suspects: half the directions are enough, and a quarter of the work.
_SECTIONS = 60
_MOST_COMPARED = 1000
# Nearer than this, and turned by less, a place is itself.
_ELSEWHERE_M, _ELSEWHERE_RAD = 2.0, math.radians(30.0)


class Outcome(enum.StrEnum):
    """Of one cold start, from one look of the standing robot."""

    LOCATED = "located"
    """At the right place at once."""
    UNSURE = "unsure"
    """The right place comes out best and has no rival, but one look is too little to be sure."""
    ALIKE = "alike"
    """Other places fit as well: no pose is given."""
    BLIND = "blind"
    """The scan shows too little to look for anything."""
    WRONG = "wrong"
    """A wrong place is taken for the right one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColdStart:
    """One of them."""

    truth: Pose2
    outcome: Outcome
    rivals: tuple[Pose2, ...]
    """Other places that fit about as well, best first."""
    odds: float
    """That the engine gave its best place."""
    even: bool
    """One of those that lie evenly over the floor: these tell what to expect."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColdStarts:
    """All of them."""

    tried: tuple[ColdStart, ...]
    spacing_m: float
    """Between those that lie evenly."""

    @property
    def even(self) -> tuple[ColdStart, ...]:
        return tuple(one for one in self.tried if one.even)

    def count(self, *outcomes: Outcome) -> int:
        """Of the even ones, with one of these outcomes."""
        return sum(one.outcome in outcomes for one in self.even)

    def share(self, *outcomes: Outcome) -> float:
        """The same as a share."""
        return self.count(*outcomes) / len(self.even) if self.even else 0.0


class Switchboard:
    """Switches the robot on in a map, which is the world as well."""

    def __init__(
        self, known: PointMap, eyes: Sequence[Eye], slam: SlamParams, params: ReportParams
    ) -> None:
        self._engine = SlamEngine(slam, known, "localization")
        self._target = known.target()
        self._eyes, self._slam, self._params = eyes, slam, params

    def start(self, truth: Pose2, *, even: bool = True) -> ColdStart:
        """The same pose sees the same noise, whatever was tried before."""
        place = [int(1e3 * value) & 0xFFFFFFFF for value in truth.as_array()]
        rng = np.random.default_rng((self._params.seed, 2, *place))
        cloud = seen(self._target, self._eyes, truth, rng, self._slam.clouds)
        request = SlamRequest(cloud=cloud, map_from_base=None, covariance=None)
        return self.judged(self._engine.update(request).answer, truth, even=even)

    def judged(self, answer: Answer, truth: Pose2, *, even: bool) -> ColdStart:
        """What an answer means for somebody who knows the truth."""
        best = answer.best
        if best is None or not answer.odds:
            return ColdStart(truth=truth, outcome=Outcome.BLIND, rivals=(), odds=0.0, even=even)
        least = self._params.alike * answer.odds[0]
        rivals = tuple(
            place.pose
            for place, odds in zip(answer.places, answer.odds, strict=True)
            if odds >= least and not self._right(place.pose, truth) and apart(place.pose, truth)
        )
        right = self._right(best.pose, truth)
        if answer.verdict is Verdict.ACCEPTED:
            outcome = Outcome.LOCATED if right else Outcome.WRONG
        elif right and not rivals:
            outcome = Outcome.UNSURE
        else:
            outcome = Outcome.ALIKE
        if outcome is Outcome.LOCATED:
            rivals = ()
        return ColdStart(
            truth=truth, outcome=outcome, rivals=rivals, odds=answer.odds[0], even=even
        )

    def _right(self, found: Pose2, truth: Pose2) -> bool:
        turn = abs((truth.inverse() @ found).theta_rad)
        near = found.distance_to(truth) <= self._params.right_m
        return near and turn <= self._params.right_rad


def cold_starts(
    known: PointMap,
    eyes: Sequence[Eye],
    places: Array,
    slam: SlamParams,
    params: ReportParams,
    progress: Progress,
) -> ColdStarts:
    """Evenly over ``places`` (n, 2), and where signatures say that another place is like them."""
    even, spacing_m = thinned(places, params.cold_starts, slam.grid_m)
    more = suspects(known, places, slam, params.suspects)
    rng = np.random.default_rng((params.seed, 3))
    headings = rng.uniform(-math.pi, math.pi, len(even) + len(more))
    board = Switchboard(known, eyes, slam, params)
    tried = []
    for row, (place, heading) in enumerate(zip([*even, *more], headings, strict=True)):
        truth = Pose2(float(place[0]), float(place[1]), float(heading))
        tried.append(board.start(truth, even=row < len(even)))
        progress((row + 1) / len(headings))
    return ColdStarts(tried=tuple(tried), spacing_m=spacing_m)


def suspects(known: PointMap, places: Array, slam: SlamParams, most: int) -> Array:
    """At most ``most`` of ``places`` (n, 2) whose signatures some other place has as well, or
    itself when turned: the most alike ones, spread over the floor."""
    compared, spacing_m = thinned(places, _MOST_COMPARED, slam.grid_m)
    if len(compared) < 2 or not most:
        return np.empty((0, 2))
    params = RdnmParams(sections=_SECTIONS)
    views = rdnm.views(known.target(), compared, params)
    packed = rdnm.pack(views)
    turned = np.arange(_SECTIONS) * (math.tau / _SECTIONS)
    same = np.minimum(turned, math.tau - turned) < _ELSEWHERE_RAD
    unlike = np.full(len(compared), np.inf)
    for row, view in enumerate(views):
        costs = rdnm.match(view, packed, params)
        near = np.hypot(*(compared - compared[row]).T) < _ELSEWHERE_M
        costs[np.ix_(near, same)] = np.inf
        unlike[row] = costs.min()
    ranked = np.argsort(unlike, kind="stable")[: 4 * most]
    return thinned(compared[np.sort(ranked)], most, spacing_m)[0]
