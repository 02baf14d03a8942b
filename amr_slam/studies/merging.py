"""Halls mapped in two sessions, merged, against the truth and against one session of it all.

Each session is mapped by the engine with simulated wheels, in a frame of its own, and bends as maps
do. The first drives six tenths of the tour, the second the last six: a fifth is in both.
"""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.engine import SlamEngine
from amr_slam.evaluation import align_se2
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.merging import Found, MergeError, MergeParams, find, join
from amr_slam.params import SlamParams
from amr_slam.simulation import World, mapping_poses
from amr_slam.simulation.aisles import warehouse
from amr_slam.simulation.buildings import alike_rooms
from amr_slam.slam_request import SlamRequest
from amr_slam.studies.scenes import is_right, seen_by_both
from amr_slam.studies.worlds import KINDS

PARAMS: Final = SlamParams()
_SPACING_M: Final = 0.8
_FIRST, _SECOND = (0.0, 0.6), (0.4, 1.0)
"""Parts of the tour."""
_HERE, _THERE = (0.0, 0.4), (0.5, 0.9)
"""Parts of the tour that are not driven twice; much of one may be seen from the other."""
_FALSE_M: Final = 0.5
_SCALE, _BEND_RADPM = 0.01, 0.005
_NOISE: Final = np.array([0.01, 0.005, 0.005])
"""Of each step of the wheels."""
_BELIEVED: Final = np.diag([0.04**2, 0.04**2, 0.03**2])
_NEAR: Final = np.array([0.05, 0.05, math.radians(2.0)])
_STEP_NS: Final = 4_000_000_000

Place = tuple[str, int, float]
"""Kind of world, seed, area in m2."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Session:
    """One drive, mapped."""

    known: PointMap
    truth: Array
    """(n, 3) world_from_base of the scans of its path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Localized:
    """What scans at true poses say of a map."""

    right: int
    """Found from nowhere, at the right place ..."""
    wrong: int
    """... and at a wrong one ..."""
    tried: int
    """... of so many."""
    median_m: float
    """Error near an expected pose ..."""
    p95_m: float
    """... and what 95 % of them stay within."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """What became of two sessions."""

    place: Place
    refused: str | None
    """Why; all below is of merged maps only."""
    found: Found | None = None
    ate_m: float = math.nan
    whole_ate_m: float = math.nan
    changes: int = 0
    """False ones: nothing has been moved."""
    merged: Localized | None = None
    whole: Localized | None = None
    cpu_s: float = 0.0


def world_of(place: Place) -> World:
    """A warehouse, a building of rooms that are alike, or one of the studies' worlds."""
    kind, seed, area_m2 = place
    if kind == "warehouse":
        return warehouse(seed, area_m2).world
    return (alike_rooms if kind == "alike" else KINDS[kind])(seed, area_m2)


def part(poses: Sequence[Pose2], share: tuple[float, float]) -> Sequence[Pose2]:
    """From the one to the other share of a way."""
    return poses[round(share[0] * len(poses)) : round(share[1] * len(poses))]


def session(world: World, poses: Sequence[Pose2], seed: int, name: str) -> Session:
    """Map along these poses (world_from_base), from the first one's frame."""
    rng = np.random.default_rng((world.seed, seed))
    scale, bend = rng.normal(0.0, [_SCALE, _BEND_RADPM])
    engine = SlamEngine(PARAMS, PointMap(PARAMS.map, name), "mapping")
    pose, joined = Pose2.identity(), []
    for number, truth in enumerate(poses):
        if number:
            step = poses[number - 1].inverse() @ truth
            noise = rng.normal(0.0, _NOISE)
            turn = step.theta_rad + bend * math.hypot(step.x_m, step.y_m) + noise[2]
            pose = pose @ Pose2(step.x_m * (1.0 + scale) + noise[0], step.y_m + noise[1], turn)
        cloud = replace(seen_by_both(world, truth, rng), stamp_ns=(number + 1) * _STEP_NS)
        covariance = _BELIEVED if number else 1e-6 * np.eye(3)
        result = engine.update(SlamRequest(cloud=cloud, map_from_base=pose, covariance=covariance))
        if result.inserted:
            joined.append(truth.as_array())
        if result.fix is not None:
            pose = result.fix.map_from_base
        if result.moved is not None:
            pose = result.moved @ pose
    engine.settle()
    return Session(known=engine.map, truth=np.array(joined))


def halves(place: Place, tried: int) -> Outcome:
    """One hall in two sessions and in one, and what each map is worth."""
    world = world_of(place)
    poses = mapping_poses(world, _SPACING_M)
    first = session(world, part(poses, _FIRST), 1, "first")
    second = session(world, part(poses, _SECOND), 2, "second")
    begun_s = time.process_time()
    try:
        found = find(first.known, second.known, PARAMS, MergeParams(), None, _nobody)
        merger = join(first.known, second.known, uuid.UUID(int=2), found, PARAMS)
    except MergeError as error:
        return Outcome(place=place, refused=str(error), cpu_s=time.process_time() - begun_s)
    cpu_s = time.process_time() - begun_s
    both = Session(known=merger.map, truth=np.concatenate([first.truth, second.truth]))
    whole = session(world, poses, 3, "whole")
    return Outcome(
        place=place,
        refused=None,
        found=found,
        ate_m=_ate_m(both),
        whole_ate_m=_ate_m(whole),
        changes=len(merger.changes),
        merged=localized(world, both, poses, tried),
        whole=localized(world, whole, poses, tried),
        cpu_s=cpu_s,
    )


def apart(place: Place) -> tuple[float | None, str]:
    """Two sessions that do not drive the same way: how far off, in m, they were merged, or None,
    and why not. More than half a metre is a false merge."""
    world = world_of(place)
    poses = mapping_poses(world, _SPACING_M)
    here = session(world, part(poses, _HERE), 4, "here")
    there = session(world, part(poses, _THERE), 5, "there")
    try:
        found = find(here.known, there.known, PARAMS, MergeParams(), None, _nobody)
    except MergeError as error:
        return None, str(error)
    expected = align_se2(here.truth, _path(here.known)) @ there.truth[:, :2]
    off = found.known_from_other @ _path(there.known)[:, :2] - expected
    off_m = float(np.hypot(*off.T).max())
    return off_m, "FALSE" if off_m > _FALSE_M else "true"


def strangers(known: Session, other: Session) -> str | None:
    """Why two halls are not merged; None where they are, which is wrong."""
    try:
        find(known.known, other.known, PARAMS, MergeParams(), None, _nobody)
    except MergeError as error:
        return str(error)
    return None


def localized(world: World, one: Session, poses: Sequence[Pose2], tried: int) -> Localized:
    """Scans beside the tour, from nowhere and near an expected pose."""
    rng = np.random.default_rng((world.seed, 9))
    map_from_world = align_se2(one.truth, _path(one.known))
    engine = SlamEngine(PARAMS, one.known, "localization")
    right, wrong, errors = 0, 0, []
    for pose in _beside(world, poses, tried, rng):
        cloud, truth = seen_by_both(world, pose, rng), map_from_world @ pose
        fix = engine.update(SlamRequest(cloud=cloud, map_from_base=None, covariance=None)).fix
        if fix is not None:
            is_there = is_right(fix.map_from_base, truth)
            right, wrong = right + is_there, wrong + (not is_there)
        expected = truth @ Pose2.from_array(rng.normal(0.0, _NEAR))
        request = SlamRequest(cloud=cloud, map_from_base=expected, covariance=np.diag(_NEAR**2))
        fix = engine.update(request).fix
        errors.append(math.inf if fix is None else fix.map_from_base.distance_to(truth))
    return Localized(
        right=right,
        wrong=wrong,
        tried=tried,
        median_m=float(np.median(errors)),
        p95_m=float(np.quantile(errors, 0.95)),
    )


def _beside(
    world: World, poses: Sequence[Pose2], count: int, rng: np.random.Generator
) -> list[Pose2]:
    found: list[Pose2] = []
    while len(found) < count:
        pose = poses[int(rng.integers(len(poses)))]
        off = Pose2.from_array(rng.uniform(-1.0, 1.0, 3) * [0.6, 0.6, math.pi])
        if world.clearance((pose @ off).translation[None])[0] > 0.4:
            found.append(pose @ off)
    return found


def _ate_m(one: Session) -> float:
    path = _path(one.known)
    off = (align_se2(path, one.truth) @ path[:, :2]) - one.truth[:, :2]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _path(known: PointMap) -> Array:
    return np.array([pose.as_array() for _, pose in known.path])


def _nobody(step: str, share: float | None) -> None:
    del step, share
