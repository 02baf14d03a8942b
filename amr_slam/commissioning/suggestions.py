"""What would make it better: boxes, each really tried in the map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from amr_slam.commissioning.boxes import (
    PALLET_BOX,
    POST,
    TWO_BOXES,
    Box,
    Shape,
    candidates,
    ranked,
    spread,
    with_box,
)
from amr_slam.commissioning.cold_starts import Outcome, Switchboard
from amr_slam.commissioning.look_alikes import Confusion, Pair
from amr_slam.commissioning.precision import Precision, Weakness, expected_covariance
from amr_slam.commissioning.settings import ReportParams
from amr_slam.commissioning.viewing import Eye
from amr_slam.fusion import error95_m
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams

_T = TypeVar("_T")

# Where boxes are looked for: this near to a pose that they are to help.
_REACH_M = 6.0
# A smaller share of helped poses is no suggestion.
_WORTH = 0.3
# A box that resolves this many needs no larger one to be tried.
_PLENTY = 0.8
_MOST_POSES = 60
_MOST_TOGETHER = 150
_APART_M = 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Resolution:
    """What a box does for places that look alike, measured by the same search as before. The boxes
    of the pairs before it stand already."""

    pair: Pair
    box: Box | None
    """The best that was found; None: none is needed any more, or none is worth it."""
    tried: int
    """Boxes that were tried."""
    poses: int
    """At which it was tried, all of them confused before."""
    before: int
    """Of these, that the boxes of the pairs before it have resolved."""
    resolved: int
    """Of these, at which the robot does not take one place of the pair for the other any more."""
    located: int
    """Of these, located at once."""

    @property
    def needless(self) -> bool:
        """Other boxes resolve it."""
        return self.box is None and self.resolved >= _PLENTY * max(self.poses, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Altogether:
    """All suggested boxes against look-alikes at once, at poses that were confused without them."""

    boxes: int
    poses: int
    located: int
    """Located at once."""
    unsure: int
    """At the right place without a rival."""


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
    altered: bool = False
    """Boxes have been put into it."""

    @property
    def passage_m(self) -> float:
        """Room to be left before a box: the robot's width and 0.6 m."""
        return 2.0 * self.slam.robot_radius_m + 0.6


def resolutions(
    trials: Trials, pairs: Sequence[Pair]
) -> tuple[tuple[Resolution, ...], Altogether | None]:
    """A box for each of the first pairs, each put beside those before it; and all of them."""
    found: list[Resolution] = []
    for pair in pairs[: trials.params.pairs_tried]:
        one = _resolution(trials, pair)
        found.append(one)
        if one.box is not None:
            trials = replace(trials, known=with_box(trials.known, one.box), altered=True)
    count = sum(one.box is not None for one in found)
    if not count:
        return tuple(found), None
    starts = {confusion.start: None for pair in pairs for confusion in pair.confused}
    chosen = evenly(list(starts), _MOST_TOGETHER)
    trials.say("all boxes together")
    board = _board(trials, trials.known)
    outcomes = [board.start(start.truth).outcome for start in chosen]
    together = Altogether(
        boxes=count,
        poses=len(chosen),
        located=outcomes.count(Outcome.LOCATED),
        unsure=outcomes.count(Outcome.UNSURE),
    )
    return tuple(found), together


def _resolution(trials: Trials, pair: Pair) -> Resolution:
    """The best box against a pair; a larger thing where a box does too little."""
    everyone = evenly(pair.confused, _MOST_POSES)
    resolved, located = _score(trials, trials.known, everyone)
    best = Resolution(
        pair=pair, box=None, tried=0, poses=len(everyone), before=resolved, resolved=resolved,
        located=located,
    )  # fmt: skip
    for shape in (PALLET_BOX, TWO_BOXES):
        if best.resolved >= _PLENTY * best.poses:
            break
        boxes = _worth_trying(trials, pair, shape)
        best = replace(best, tried=best.tried + len(boxes))
        if not boxes:
            continue
        sample = evenly(pair.confused, trials.params.poses_a_box)
        scores = []
        for one in boxes:
            scores.append(_score(trials, with_box(trials.known, one), sample))
            trials.say(f"pair {pair.letter}: {shape.name}: {scores[-1][0]} of {len(sample)}")
        box = boxes[scores.index(max(scores))]
        resolved, located = _score(trials, with_box(trials.known, box), everyone)
        if resolved > best.resolved and resolved - best.before >= _WORTH * best.poses:
            best = replace(best, box=box, resolved=resolved, located=located)
    return best


def _worth_trying(trials: Trials, pair: Pair, shape: Shape) -> list[Box]:
    poses = [
        (one.start.truth, one.rivals[0]) for one in evenly(pair.confused, trials.params.poses_a_box)
    ]
    places = np.array([pose.translation for several in poses for pose in several])
    found = candidates(trials.known, places, _REACH_M, shape, trials.passage_m)
    found = ranked(found, trials.known.target(), trials.eyes, poses, trials.slam.clouds)
    return spread(found, trials.params.boxes_tried, _APART_M)


def _board(trials: Trials, known: PointMap) -> Switchboard:
    return Switchboard(known, trials.eyes, trials.slam, trials.params)


def _score(trials: Trials, known: PointMap, tried: Sequence[Confusion]) -> tuple[int, int]:
    """How many are not so confused any more with this map as map and world, and how many of all
    are located at once."""
    if known is trials.known and not trials.altered:
        return 0, 0
    board = _board(trials, known)
    again = [(one, board.start(one.start.truth)) for one in tried]
    resolved = sum(not one.remains_in(start) for one, start in again)
    return resolved, sum(start.outcome is Outcome.LOCATED for _, start in again)


def anchor(trials: Trials, found: Precision, weakness: Weakness) -> Anchor:
    """The best narrow box against a badly constrained area."""
    rows = weakness.rows
    chosen = rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST_POSES)).astype(np.intp)]
    poses = [Pose2.from_array(row) for row in found.poses[chosen]]
    near = found.places_m[chosen]
    boxes = candidates(trials.known, near, _REACH_M, POST, trials.passage_m)
    target = trials.known.target()
    boxes = ranked(
        boxes, target, trials.eyes, [(pose,) for pose in evenly(poses, 12)], trials.slam.clouds
    )
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


def _errors(trials: Trials, after: PointMap, poses: Sequence[Pose2]) -> Array:
    rng = np.random.default_rng((trials.params.seed, 4))
    target = after.target()
    return np.array(
        [
            error95_m(expected_covariance(target, trials.eyes, pose, trials.slam, rng))
            for pose in poses
        ]
    )


def evenly(values: Sequence[_T], most: int) -> list[_T]:
    """At most so many of them, from all parts of the sequence."""
    if len(values) <= most:
        return list(values)
    return [values[row] for row in np.linspace(0, len(values) - 1, most).astype(np.intp)]
