"""Where one map lies in another: one place, by many witnesses, with nothing else near it; or not.

A false merge spoils two maps at once and is not seen before a robot goes astray, so it is refused
wherever the maps do not say it themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Gt, Interval

from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.map import PointMap
from amr_slam.merging.overlay import Overlay, lay
from amr_slam.merging.scans import kept_rows, path_poses, shared_scans, spread_rows
from amr_slam.merging.votes import Say, Votes, candidates, poll
from amr_slam.params import SlamParams

_SAME_M: Final = 0.5
_SAME_RAD: Final = 0.05
_HINT: Final = "say where about by --near X,Y,THETA_DEG, the second map's origin in the first"


class MergeError(Exception):
    """Two maps that are not merged; the message says why and what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeParams:
    """When a map is believed to lie in another one."""

    looks: Annotated[int, Ge(3)] = 40
    """Scans that are sought in the whole of the other map."""
    ways: Annotated[int, Ge(2)] = 6
    """Ways to lie on each other that are looked at closely."""
    judged: Annotated[int, Ge(3)] = 120
    """Scans of each map by which a way is judged."""
    witnesses: Annotated[int, Ge(1)] = 4
    """So many scans, sought on their own, must say the same."""
    common_m2: Annotated[float, Gt(0.0)] = 10.0
    """So much floor must be in both."""
    fits: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.7
    """So much of what both should have must be in both ..."""
    contradicts: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.15
    """... and no more may stand on the other's floor."""
    rival: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.5
    """No other way may have so much evidence, of the best one's."""
    near_m: Annotated[float, Ge(0.0)] = 5.0
    """A hint is right by this ..."""
    near_rad: Annotated[float, Ge(0.0)] = math.radians(45.0)
    """... and by this."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """Where the other map lies, and what speaks for it."""

    overlay: Overlay
    witnesses: int
    """Scans that were found there, each sought in the whole map on its own ..."""
    sought: int
    """... of so many."""
    rival: tuple[Pose2, float] | None
    """The next best way, and its evidence by the best one's."""

    @property
    def known_from_other(self) -> Pose2:
        return self.overlay.known_from_other


def find(
    known: PointMap,
    other: PointMap,
    params: SlamParams,
    rules: MergeParams,
    near: Pose2 | None,
    say: Say,
) -> Found:
    """Where ``other`` lies in ``known``. ``near``: known_from_other, as a person has it; only about
    there is looked. Raises MergeError."""
    _check(known, other)
    middle = path_poses(other)[:, :2].mean(axis=0)
    votes = poll(known, other, spread_rows(other, rules.looks), params, near, say)
    if near is not None and len(votes.odds):
        votes = votes.within(lambda way: _is_near(way, near, middle, rules))
    ways = candidates(votes, rules.ways)
    laid: list[Overlay] = []
    for done, way in enumerate(ways):
        say("laying the maps on each other", done / len(ways))
        overlay = lay(known, other, way, rules.judged, params)
        if overlay is not None and not any(_same(overlay, before, middle) for before in laid):
            laid.append(overlay)
    laid.sort(key=lambda one: -one.evidence)
    return _judged(votes, laid, rules, near)


def _check(known: PointMap, other: PointMap) -> None:
    for name, one in (("first", known), ("second", other)):
        if one.imported is not None:
            raise MergeError(
                f"the {name} map was imported: it has no scans to be found by; extend it with the "
                "recording instead (replay --map ... --mapping --hold)"
            )
        if len(kept_rows(one)) < 3 or not len(one):
            raise MergeError(
                f"the {name} map keeps the rays of no scans (it is empty, or an old version made "
                "it): map again"
            )
    shared = shared_scans(known, other)
    if shared:
        raise MergeError(
            f"{shared} scans of the second map are in the first already: they are versions of one "
            "map ('map diff' compares them), or were merged before"
        )
    if known.params.free_cell_m != other.params.free_cell_m:
        raise MergeError(
            f"their cells of free space differ, {known.params.free_cell_m:g} m and "
            f"{other.params.free_cell_m:g} m: map again with one slam.map.free_cell_m"
        )


def _is_near(way: Pose2, near: Pose2, middle: Array, rules: MergeParams) -> bool:
    """By the second map's origin, which the hint tells of, or by its middle: the origin of a site
    may lie far from the hall, where the least turn moves it by metres."""
    turn = abs(wrap_angle(way.theta_rad - near.theta_rad))
    off_m = min(way.distance_to(near), _off_m(way, near, middle))
    return off_m <= rules.near_m and turn <= rules.near_rad


def _same(one: Overlay, before: Overlay, middle: Array) -> bool:
    """By where the middle of the scans comes to lie."""
    a, b = one.known_from_other, before.known_from_other
    turn = abs(wrap_angle(a.theta_rad - b.theta_rad))
    return _off_m(a, b, middle) <= _SAME_M and turn <= _SAME_RAD


def _off_m(one: Pose2, other: Pose2, place: Array) -> float:
    return float(np.hypot(*(one @ place[np.newaxis] - other @ place[np.newaxis])[0]))


def _judged(
    votes: Votes,
    laid: Sequence[Overlay],
    rules: MergeParams,
    near: Pose2 | None,
) -> Found:
    where = "" if near is None else " near the hint"
    if not laid:
        raise MergeError(
            f"the second map fits nowhere in the first{where}: of {votes.sought} scans "
            f"{votes.sure} were found; "
            + (f"do they overlap? {_HINT}" if near is None else "is the hint right?")
        )
    best, *others = laid
    rival = None
    if others and best.evidence > 0.0:
        rival = others[0].known_from_other, max(others[0].evidence, 0.0) / best.evidence
    if rival is not None and rival[1] >= rules.rival:
        raise MergeError(
            f"ambiguous: {told(rival[0])} has {rival[1]:.0%} of the evidence for "
            f"{told(best.known_from_other)}: "
            + (_HINT if near is None else "mark the place by something that is there only once")
        )
    witnesses = votes.witnesses(best.known_from_other)
    problem = _problem(witnesses, best, rules)
    if problem is not None:
        at = told(best.known_from_other)
        raise MergeError(f"not merged: at {at}, where they fit best{where}, {problem}")
    return Found(overlay=best, witnesses=witnesses, sought=votes.sought, rival=rival)


def _problem(witnesses: int, best: Overlay, rules: MergeParams) -> str | None:
    if best.fits < rules.fits:
        return (
            f"{best.fits:.0%} of what both should have is in both, {rules.fits:.0%} must be: is it "
            "the same hall?"
        )
    if best.contradicts > rules.contradicts:
        return (
            f"{best.contradicts:.0%} of what one has stands on the other's floor, at most "
            f"{rules.contradicts:.0%} may: is it the same hall?"
        )
    if best.common_m2 < rules.common_m2:
        return (
            f"they have {best.common_m2:.0f} m2 of floor in common, {rules.common_m2:.0f} must be: "
            "map more of what both have"
        )
    if witnesses < rules.witnesses:
        return (
            f"{witnesses} scans are found on their own, {rules.witnesses} must be: map more of "
            f"what both have, or {_HINT}"
        )
    return None


def told(pose: Pose2) -> str:
    """As ``--near`` takes it."""
    return f"{pose.x_m:.1f},{pose.y_m:.1f},{math.degrees(pose.theta_rad):.0f}"
