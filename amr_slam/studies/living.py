"""A day in a laboratory whose furniture moves every hour, among people who are always about.

Twice over the same scans: in the map of the first hour all day, and in one that takes in changes by
a policy. Scans are thinned (one a metre), and what wheels and fusion would expect is drawn around
the truth; what is registered, watched and accepted is the product's. The truth is the simulator's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from amr_slam.clouds import Cloud, cloud_from_scan
from amr_slam.engine import SlamEngine
from amr_slam.evidence import Verdict
from amr_slam.geometry import Array, Pose2
from amr_slam.living import AcceptPolicy, MapChange, Watcher, accept, eligible
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.pictures import draw_changes
from amr_slam.simulation import (
    PERSON_RADIUS_M,
    World,
    free_poses,
    laboratory,
    moved_furniture,
    plan_tour,
    take_scan,
)
from amr_slam.simulation.shapes import distance_to_segments
from amr_slam.slam_request import SlamRequest
from amr_slam.studies.scenes import MAPPING_SCANS, S300, Scene, along, is_right

_PEOPLE: Final = 5
"""Elsewhere in each scan; one of them stands where he is for a visit."""
_VISITS: Final = 2
"""An hour, each once through the room."""
_SCANS: Final = 40
"""A visit: one a metre."""
_PERIOD_S: Final = 3.3
"""Between them, at 0.3 m/s."""
_AWAY_S: Final = 1700.0
"""From one visit to the next."""
_ANYWHERE: Final = 4
"""Scans of a visit that are sought without any prior too."""
_EXPECTED: Final = np.diag([0.1**2, 0.1**2, math.radians(2.0) ** 2])
"""What is known of the pose before a scan: the wheels' after some metres."""
_MOVED: Final = 0.12
"""Share of what stands freely that is elsewhere an hour later: one thing or two of ten."""
_POLICY: Final = AcceptPolicy(passes=2, age_h=0.3, area_m2=10.0)
_SOLID_M: Final = 0.28
_ON_M: Final = 0.2
"""A cell this near to an outline, and its own size, shows it."""


@dataclass(slots=True, kw_only=True)
class Hour:
    """What one hour showed of one map."""

    scans: int = 0
    right: int = 0
    """Scans that were accepted at the right place, near the expected pose ..."""
    sought: int = 0
    found_again: int = 0
    """... and of those that were sought without one."""
    wrong: int = 0
    """Scans that were accepted at a wrong place, either way."""
    explained: list[float] = field(default_factory=list)
    """Share of each accepted scan that lies on the map's walls."""
    found: int = 0
    """Things that the watched list has, ..."""
    things: int = 0
    """... of those that truly differ from the map of the first hour;"""
    listed: int = 0
    """entries in that list, ..."""
    true: int = 0
    """... and those that are so."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Look:
    cloud: Cloud
    truth: Pose2
    expected: Pose2
    anywhere: bool


class Keeping:
    """One map over the day: localized in, watched, and perhaps renewed."""

    def __init__(self, known: PointMap, params: SlamParams, policy: AcceptPolicy | None) -> None:
        self._params, self._policy = params, policy
        self.known = known
        self.watcher = Watcher(known, params.watching)
        self.taken = 0
        self.hours: list[Hour] = []
        self._engine = SlamEngine(params, known, "localization")
        self._engine.watcher = self.watcher

    def look(self, seen: _Look, hour: Hour) -> None:
        """Register one scan, with what the wheels expect, and perhaps without."""
        request = SlamRequest(cloud=seen.cloud, map_from_base=seen.expected, covariance=_EXPECTED)
        result = self._engine.update(request)
        hour.scans += 1
        if result.fix is not None:
            right = is_right(result.fix.map_from_base, seen.truth)
            hour.right += right
            hour.wrong += not right
            if result.change is not None:
                hour.explained.append(result.change.explained)
        if seen.anywhere:
            request = SlamRequest(cloud=seen.cloud, map_from_base=None, covariance=None)
            answer = self._engine.update(request).answer
            hour.sought += 1
            if answer.verdict is Verdict.ACCEPTED and answer.best is not None:
                right = is_right(answer.best.pose, seen.truth)
                hour.found_again += right
                hour.wrong += not right

    def close(self, hour: Hour) -> None:
        """The hour is over: what the policy accepts becomes the map."""
        self.hours.append(hour)
        if self._policy is None:
            return
        done = accept(self.known, self.watcher, eligible(self.watcher.diff(), self._policy))
        if done.taken:
            self.taken += len(done.taken)
            self.known = done.map
            self.watcher.rebase(done.map)
            self._engine = SlamEngine(self._params, done.map, "localization")
            self._engine.watcher = self.watcher


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Day:
    """The whole study."""

    fixed: Keeping
    renewed: Keeping
    first: World
    worlds: tuple[World, ...]
    """Of each hour."""


def day(seed: int, hours: int, progress: Callable[[str], object]) -> Day:
    """``hours`` of it in one laboratory; the same seed gives the same day."""
    rng = np.random.default_rng((seed, 31))
    params = SlamParams()
    first = world = laboratory(seed)
    mapping = along(plan_tour(world).path_m, MAPPING_SCANS)
    known = Scene.of(world, "laboratory", mapping).map_at_truth(S300, params)
    fixed, renewed = Keeping(known, params, None), Keeping(known, params, _POLICY)
    worlds: list[World] = []
    for number in range(hours):
        world = _changed(world, rng) if number else world
        worlds.append(world)
        hour, other = Hour(), Hour()
        for seen in _looks(world, number, rng):
            fixed.look(seen, hour)
            renewed.look(seen, other)
        _judge(fixed.watcher.diff().changes, first, world, hour)
        fixed.close(hour)
        renewed.close(other)
        progress(
            f"hour {number + 1}: right {hour.right} and {other.right} of {hour.scans}, "
            f"{hour.found} of {hour.things} things listed, {hour.true} of {hour.listed} entries "
            f"true, {renewed.taken} taken"
        )
    return Day(fixed=fixed, renewed=renewed, first=first, worlds=tuple(worlds))


def _changed(world: World, rng: np.random.Generator) -> World:
    """An hour later; a world in which no tour is left is drawn again."""
    while True:
        changed = moved_furniture(world, rng, _MOVED)
        try:
            plan_tour(changed)
        except ValueError:
            continue
        return changed


def _looks(world: World, number: int, rng: np.random.Generator) -> Iterator[_Look]:
    poses, clouds = along(plan_tour(world).path_m, _SCANS), SlamParams().clouds
    for visit in range(_VISITS):
        begun_s = 3600.0 * (number + 1) + _AWAY_S * visit
        places = free_poses(world, rng, _PEOPLE * (_SCANS + 1), PERSON_RADIUS_M)
        people = np.array([[place.x_m, place.y_m] for place in places])
        people = people.reshape(_SCANS + 1, _PEOPLE, 2)
        for row, pose in enumerate(poses):
            here = pose @ Pose2(*rng.normal(0.0, [0.1, 0.1, 0.1]).tolist())
            crowd = np.concatenate([people[row, 1:], people[-1, :1]])
            near = np.hypot(*(crowd - here.translation).T) < PERSON_RADIUS_M + 0.4
            crowd = crowd[~near]
            scan = take_scan(
                S300, world, here, rng,
                stamp_ns=round(1e9 * (begun_s + _PERIOD_S * row)),
                people_m=np.broadcast_to(crowd, (S300.beams, *crowd.shape)),
                person_radius_m=PERSON_RADIUS_M,
            )  # fmt: skip
            off = rng.multivariate_normal(np.zeros(3), 0.25 * _EXPECTED)
            yield _Look(
                cloud=cloud_from_scan(scan, S300.base_from_lidar, clouds),
                truth=here,
                expected=here @ Pose2(*off.tolist()),
                anywhere=row % (_SCANS // _ANYWHERE) == 0,
            )


# -- what truly moved


def solids(world: World) -> list[Array]:
    """(4 or more, 4) segments of each solid thing that stands freely and is wide enough to be
    told from a leg."""
    segments = world.segments_m
    joins = np.all(segments[1:, :2] == segments[:-1, 2:], axis=1)
    chains = np.split(segments, np.flatnonzero(~joins) + 1)
    closed = [c for c in chains if len(c) >= 3 and np.array_equal(c[0, :2], c[-1, 2:])]
    return [c for c in closed if np.ptp(c[:, :2], axis=0).min() > _SOLID_M]


def _judge(changes: Sequence[MapChange], first: World, now: World, hour: Hour) -> None:
    before, after = solids(first), solids(now)
    truly = {
        "gone": [one for one in before if not _among(one, after)],
        "new": [one for one in after if not _among(one, before)],
    }
    for kind, things in truly.items():
        listed = [change for change in changes if change.kind == kind]
        hour.things += len(things)
        hour.found += sum(any(_shows(c, thing) for c in listed) for thing in things)
        hour.listed += len(listed)
        hour.true += sum(any(_shows(c, thing) for thing in things) for c in listed)


def _among(thing: Array, others: Sequence[Array]) -> bool:
    return any(np.array_equal(thing, other) for other in others)


def _shows(change: MapChange, thing: Array) -> bool:
    """Whether a fair part of the change's cells lies on the thing's outline."""
    on = distance_to_segments(change.cells_m, thing) <= _ON_M
    return bool(on.sum() >= max(3, 0.25 * len(on)))


def strangers(known: PointMap, worlds: Sequence[World]) -> float:
    """Share of the map's wall points that are on no wall of any of the worlds: people."""
    points = known.target().points_m
    walls = np.concatenate([world.segments_m for world in worlds])
    return float(np.mean(distance_to_segments(points, walls) > _ON_M))


# -- telling


def table(done: Day) -> str:
    """Four hours a line, as Markdown."""
    lines = [
        "| hours | map | right of scans | found from nowhere | wrong | on walls | listed | true |",
        "|---|---|--:|--:|--:|--:|--:|--:|",
    ]
    for begin in range(0, len(done.fixed.hours), 4):
        for name, kept in (("first hour's", done.fixed), ("renewed", done.renewed)):
            part = kept.hours[begin : begin + 4]
            told = [
                f"{sum(h.right for h in part)} of {sum(h.scans for h in part)}",
                f"{sum(h.found_again for h in part)} of {sum(h.sought for h in part)}",
                f"{sum(h.wrong for h in part)}",
                f"{np.mean([one for h in part for one in h.explained]):.2f}",
            ]
            if kept is done.fixed:
                told += [
                    f"{sum(h.found for h in part)} of {sum(h.things for h in part)} things",
                    f"{sum(h.true for h in part)} of {sum(h.listed for h in part)} entries",
                ]
            else:
                told += ["", ""]
            lines.append(f"| {begin + 1}..{begin + len(part)} | {name} | {' | '.join(told)} |")
    return "\n".join(lines) + "\n"


def draw(done: Day, folder: Path) -> None:
    """``living-day.png`` and ``living-changes.png``."""
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 2)
    hours = np.arange(1, len(done.fixed.hours) + 1)
    for kept, label, colour, style in (
        (done.fixed, "map of the first hour", "#D55E00", "s--"),
        (done.renewed, "map renewed by the policy", "#0072B2", "o-"),
    ):
        right = [100.0 * h.right / max(h.scans, 1) for h in kept.hours]
        panels[0].plot(hours, right, style, color=colour)
        explained = [100.0 * float(np.mean(h.explained)) for h in kept.hours]
        panels[1].plot(hours, explained, style, color=colour, label=label)
    panels[0].set_ylabel("% of scans accepted at the right place")
    panels[0].set_ylim(0.0, 102.0)
    panels[1].set_ylabel("% of a scan on the map's walls")
    panels[1].legend(fontsize=8)
    for axes in panels:
        axes.set_xlabel("hour")
        axes.grid(visible=True, color="#DDDDDD")
    figure.savefig(folder / "living-day.png", dpi=120, metadata={"Software": None})
    draw_changes(
        done.fixed.known,
        done.fixed.watcher.diff(),
        folder / "living-changes.png",
        f"changes against the map of the first hour, after {len(hours)} hours",
    )
