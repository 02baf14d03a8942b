"""What would make it better: boxes, each really tried in the map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from amr_slam.commissioning.boxes import (
    PALLET_BOX,
    PARTITION,
    POST,
    Box,
    Shape,
    candidates,
    ranked,
    spread,
    with_box,
)
from amr_slam.commissioning.cold_starts import ColdStart, Outcome, Switchboard
from amr_slam.commissioning.look_alikes import Pair
from amr_slam.commissioning.precision import Precision, Weakness, expected_covariance
from amr_slam.commissioning.settings import ReportParams
from amr_slam.commissioning.viewing import Eye
from amr_slam.fusion import error95_m
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams

# Where boxes are looked for: this near to a pose that they are to help.
_REACH_M = 6.0
# A smaller share of helped poses is no suggestion.
_WORTH = 0.3
# A box that resolves this many needs no larger one to be tried.
_PLENTY = 0.8
_MOST_POSES = 60
_APART_M = 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Resolution:
    """What a box does for places that look alike, measured by the same search as before."""

    pair: Pair
    box: Box | None
    """The best that was found; None: none of those that were tried is worth it."""
    tried: int
    """Boxes that were tried."""
    poses: int
    """At which it was tried, all of them confused before."""
    resolved: int
    """Of these, not confused any more."""
    located: int
    """Of these, located at once."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Anchor:
    """What a box does for an area where scans tell little, by the same figures as before."""

    weakness: Weakness
    box: Box | None
    tried: int
    places: int
    before_m: float
    """Median of the expected errors in the area."""
    after_m: float
    """The same with the box."""
    good_after: int
    """Places that are not poor any more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trials:
    """What all trials of boxes need."""

    known: PointMap
    eyes: Sequence[Eye]
    slam: SlamParams
    params: ReportParams
    say: Callable[[str], None]

    @property
    def passage_m(self) -> float:
        """Room to be left before a box: the robot's width and 0.6 m."""
        return 2.0 * self.slam.robot_radius_m + 0.6


def resolution(trials: Trials, pair: Pair) -> Resolution:
    """The best box against a pair of look-alikes; a larger thing where a box does too little."""
    best = _nothing(pair)
    for shape in (PALLET_BOX, PARTITION):
        one = _resolution(trials, pair, shape)
        tried = best.tried + one.tried
        better = one if _merit(one) > _merit(best) else best
        best = _counted(better, tried)
        if best.poses and best.resolved >= _PLENTY * best.poses:
            break
    if best.poses and best.resolved < _WORTH * best.poses:
        return _counted(_nothing(pair), best.tried)
    return best


def _resolution(trials: Trials, pair: Pair, shape: Shape) -> Resolution:
    sample = _evenly(pair.starts, trials.params.poses_a_box)
    poses = [start.truth for start in sample]
    places = np.array([pose.translation for pose in poses])
    target = trials.known.target()
    found = candidates(trials.known, places, _REACH_M, shape, trials.passage_m)
    found = ranked(found, target, trials.eyes, poses, trials.slam.clouds)
    found = spread(found, trials.params.boxes_tried, _APART_M)
    best, most = None, (-1, -1)
    for one in found:
        score = _score(_switched_on(trials, one, sample))
        trials.say(f"pair {pair.letter}: {shape.name}: {score[0]} of {len(sample)}")
        if score > most:
            best, most = one, score
    if best is None:
        return _nothing(pair)
    everyone = _evenly(pair.starts, _MOST_POSES)
    resolved, located = _score(_switched_on(trials, best, everyone))
    return Resolution(
        pair=pair, box=best, tried=len(found), poses=len(everyone), resolved=resolved,
        located=located,
    )  # fmt: skip


def _switched_on(trials: Trials, one: Box, starts: Sequence[ColdStart]) -> list[ColdStart]:
    """The same cold starts with the box in the map, and in the world."""
    board = Switchboard(with_box(trials.known, one), trials.eyes, trials.slam, trials.params)
    return [board.start(start.truth) for start in starts]


def _score(starts: Sequence[ColdStart]) -> tuple[int, int]:
    """How many are not confused, and how many are located at once."""
    located = sum(start.outcome is Outcome.LOCATED for start in starts)
    return located + sum(start.outcome is Outcome.UNSURE for start in starts), located


def _nothing(pair: Pair) -> Resolution:
    return Resolution(pair=pair, box=None, tried=0, poses=0, resolved=0, located=0)


def _merit(one: Resolution) -> float:
    return one.resolved / one.poses if one.poses else -1.0


def _counted(one: Resolution, tried: int) -> Resolution:
    return Resolution(
        pair=one.pair, box=one.box, tried=tried, poses=one.poses, resolved=one.resolved,
        located=one.located,
    )  # fmt: skip


def anchor(trials: Trials, found: Precision, weakness: Weakness) -> Anchor:
    """The best narrow box against a badly constrained area."""
    rows = weakness.rows
    chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST_POSES)).astype(np.intp)]
    poses = [Pose2.from_array(row) for row in found.poses[chosen]]
    near = found.places_m[chosen]
    boxes = candidates(trials.known, near, _REACH_M, POST, trials.passage_m)
    target = trials.known.target()
    boxes = ranked(boxes, target, trials.eyes, _some(poses, 12), trials.slam.clouds)
    boxes = spread(boxes, trials.params.boxes_tried, 2.0 * _APART_M)
    best, least = None, None
    for one in boxes:
        after = _errors(trials, with_box(trials.known, one), poses)
        poor = int(np.sum(after > trials.params.poor_m))
        key = (poor, float(np.median(after)))
        trials.say(f"weak area: post: {poor} of {len(poses)} still poor")
        if least is None or key < least:
            best, least = one, key
    before = float(np.median(found.error95_m[chosen]))
    if best is None or least is None or least[0] > (1.0 - _WORTH) * len(poses):
        best, least = None, (len(poses), before)
    return Anchor(
        weakness=weakness, box=best, tried=len(boxes), places=len(poses), before_m=before,
        after_m=least[1], good_after=len(poses) - least[0],
    )  # fmt: skip


def _errors(trials: Trials, after: PointMap, poses: Sequence[Pose2]) -> np.ndarray:
    rng = np.random.default_rng((trials.params.seed, 4))
    target = after.target()
    return np.array(
        [
            error95_m(expected_covariance(target, trials.eyes, pose, trials.slam, rng))
            for pose in poses
        ]
    )


def _evenly(starts: Sequence[ColdStart], most: int) -> list[ColdStart]:
    if len(starts) <= most:
        return list(starts)
    return [starts[row] for row in np.linspace(0, len(starts) - 1, most).astype(np.intp)]


def _some(poses: Sequence[Pose2], most: int) -> list[Pose2]:
    if len(poses) <= most:
        return list(poses)
    return [poses[row] for row in np.linspace(0, len(poses) - 1, most).astype(np.intp)]
