"""A map laid on a floor plan: every place and heading tried, the promising ones refined.

The plan has walls that were never seen, and lacks the furniture that was: only what both have
counts. Where it fits in more than one way (halls repeat themselves by half turns), it is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Gt, Interval
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amr_slam.aligning.exact import Exact, refined
from amr_slam.aligning.pairs import AlignError
from amr_slam.aligning.plan import FloorPlan
from amr_slam.clouds import Cloud
from amr_slam.geometry import Pose2, wrap_angle
from amr_slam.map import PointMap
from amr_slam.registration import field
from amr_slam.registration.alignment import Target
from amr_slam.registration.field import FieldParams
from amr_slam.registration.icp import IcpParams, align_many

_MOST_PLACES: Final = 60_000
_LEAST_POINTS: Final = 20
_LEAST_SPACING_M: Final = 0.4
_LOOKED_AT_M: Final = 0.15
"""The two are compared by points this far apart."""
_COARSE: Final = IcpParams(reach_m=0.7, kernel_m=0.15, narrowing_iterations=10, max_iterations=40)
_MOST_SIGMA_RAD: Final = math.radians(0.5)
_LEAST_SCALE: Final = 0.004
"""Pixels and the widths of lines in a plan look like a scale of this size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanParams:
    """When a plan is believed to fit."""

    near_m: Annotated[float, Gt(0.0)] = 0.15
    """A wall point this near to one of the plan is one of it."""
    explained: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.6
    """So much of the plan's walls, where the map has looked, must be in the map."""
    rival: Annotated[float, Interval(ge=0.0, le=1.0)] = 0.85
    """Another place that fits this much as well as the best makes it ambiguous."""
    near_place_m: Annotated[float, Ge(0.0)] = 5.0
    """A hint is right by this ..."""
    near_turn_rad: Annotated[float, Ge(0.0)] = math.radians(45.0)
    """... and by this."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanFit:
    """Where the map lies on the plan."""

    exact: Exact
    explained: float
    """Share of the plan's walls, where the map has looked, that are in the map."""
    shared: float
    """Share of the map's walls that are in the plan; the rest is furniture."""
    rival: tuple[Pose2, float] | None
    """The best other place, and how well it fits by the best one's."""
    findings: tuple[str, ...]
    """What people should know."""
    problems: tuple[str, ...]
    """Why it must not be used; empty where it may."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    pose: Pose2
    quality: float
    explained: float
    shared: float


def fit_plan(
    known: PointMap, plan: FloorPlan, params: PlanParams, near: Pose2 | None = None
) -> PlanFit:
    """Find the map in the plan. ``near``: site_from_map, roughly: only about there is searched.

    Raises AlignError where it fits nowhere.
    """
    walls = known.surfaces()
    if len(walls) < _LEAST_POINTS:
        raise AlignError("the map has hardly any wall")
    x_min, y_min, x_max, y_max = known.bounds()
    middle = Pose2(0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.0)
    source = _cloud(walls, middle.inverse())
    target = Target(points_m=plan.points_m, normals=plan.normals)
    candidates = _candidates(source, target, plan, params, near and near @ middle)
    if not candidates:
        raise AlignError("the map fits nowhere in the floor plan, or nowhere near the hint")
    aligned = align_many(source, target, candidates, _COARSE)
    compared = _Compared.of(known, walls, plan)
    places = sorted(
        (compared.at(one.target_from_source @ middle.inverse(), params) for one in aligned),
        key=lambda place: -place.quality,
    )
    best = places[0]
    rivals = [place for place in places if _elsewhere(best.pose @ middle, place.pose @ middle)]
    return _judged(known, plan, best, rivals[0] if rivals else None, params, near, middle)


def _cloud(walls: Target, source_from_map: Pose2) -> Cloud:
    """The walls as if they were one scan, by points evenly spread."""
    cell = np.floor(walls.points_m / _LOOKED_AT_M).astype(np.int64)
    _, rows = np.unique(cell, axis=0, return_index=True)
    points = source_from_map @ walls.points_m[rows]
    return Cloud(
        stamp_ns=0,
        points_m=points,
        normals=walls.normals[rows] @ source_from_map.rotation.T,
        origins_m=np.zeros_like(points),
        weights=np.ones(len(rows)),
        scanners=np.zeros(len(rows), dtype=np.int8),
        sigma_m=0.0,
        across_m=0.0,
    )


def _candidates(
    source: Cloud, target: Target, plan: FloorPlan, params: PlanParams, near: Pose2 | None
) -> list[Pose2]:
    """Rough poses of the source in the plan, best first. ``near``: of the same point."""
    radius_m = float(np.percentile(np.hypot(*source.points_m.T), 90.0))
    headings = int(np.clip(math.ceil(math.tau * radius_m / 0.6 / 8.0) * 8, 90, 720))
    low, high = plan.points_m.min(axis=0), plan.points_m.max(axis=0)
    if near is not None:
        low, high = near.translation - params.near_place_m, near.translation + params.near_place_m
    spacing_m = max(_LEAST_SPACING_M, math.sqrt(float(np.prod(high - low)) / _MOST_PLACES))
    x, y = (np.arange(a, b + spacing_m, spacing_m) for a, b in zip(low, high, strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    searched = FieldParams(
        spacing_m=spacing_m, headings=headings, reach_m=1.0, first_points=80, points=600,
        candidates=300,
    )  # fmt: skip
    found = field.search(source, field.build(target, searched), places, searched)
    poses = [Pose2.from_array(pose) for pose in found[:, :3]]
    if near is not None:
        poses = [
            pose
            for pose in poses
            if abs(wrap_angle(pose.theta_rad - near.theta_rad)) <= params.near_turn_rad
        ]
    return poses


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Compared:
    """What is needed to say how well a place fits."""

    known: PointMap
    walls: Target
    plan: FloorPlan
    plan_tree: cKDTree
    wall_rows: NDArray[np.intp]
    plan_rows: NDArray[np.intp]

    @staticmethod
    def of(known: PointMap, walls: Target, plan: FloorPlan) -> _Compared:
        rows = [
            np.unique(np.floor(points / _LOOKED_AT_M).astype(np.int64), axis=0, return_index=True)[
                1
            ]
            for points in (walls.points_m, plan.points_m)
        ]
        return _Compared(
            known=known,
            walls=walls,
            plan=plan,
            plan_tree=cKDTree(plan.points_m),
            wall_rows=rows[0],
            plan_rows=rows[1],
        )

    def at(self, site_from_map: Pose2, params: PlanParams) -> _Place:
        """Walls of the map that the plan has, and walls of the plan that the map must have: those
        where it has looked. A wall in the middle of seen floor speaks against a place."""
        moved = site_from_map @ self.walls.points_m[self.wall_rows]
        shared = float(np.mean(np.asarray(self.plan_tree.query(moved)[0]) <= params.near_m))
        back = site_from_map.inverse() @ self.plan.points_m[self.plan_rows]
        there = np.asarray(self.walls.tree.query(back)[0]) <= params.near_m
        space = self.known.space
        row = space.find(space.keys_of(back))
        floor = (row >= 0) & (space.sums[row, 0] > space.sums[row, 1])
        looked = there | floor
        explained = float(there.sum() / looked.sum()) if looked.any() else 0.0
        return _Place(
            pose=site_from_map, quality=shared * explained, explained=explained, shared=shared
        )


def _elsewhere(one: Pose2, other: Pose2) -> bool:
    turn = abs(wrap_angle(one.theta_rad - other.theta_rad))
    return one.distance_to(other) > 0.7 or turn > math.radians(5.0)


def _judged(
    known: PointMap,
    plan: FloorPlan,
    best: _Place,
    rival: _Place | None,
    params: PlanParams,
    near: Pose2 | None,
    middle: Pose2,
) -> PlanFit:
    exact = refined(known.surfaces(), plan, best.pose, params.near_m, middle)
    if len(exact.points_m) < _LEAST_POINTS:
        raise AlignError("the map fits nowhere in the floor plan, or nowhere near the hint")
    problems, findings = [], []
    if best.explained < params.explained:
        problems.append(
            f"of the plan's walls that should be seen in the map, {best.explained:.0%} are "
            f"({params.explained:.0%} must be): is its resolution right, is it this hall?"
        )
    share = rival.quality / best.quality if rival is not None and best.quality > 0.0 else 0.0
    if rival is not None and share >= params.rival:
        problems.append(
            f"ambiguous: {_told(rival.pose)} fits {share:.0%} as well as {_told(best.pose)}: "
            + ("name the right one by --near" if near is None else "align by landmarks or pairs")
        )
    if exact.sigma_rad > _MOST_SIGMA_RAD:
        problems.append("too little of the plan is in the map to tell the turn")
    off = exact.scale - 1.0
    if abs(off) > max(_LEAST_SCALE, 4.0 * exact.scale_sigma):
        findings.append(
            f"the plan is {'larger' if off > 0.0 else 'smaller'} than the map by {abs(off):.1%} "
            f"(+- {2.0 * exact.scale_sigma:.1%}): is its resolution right? The map is not stretched"
        )
    return PlanFit(
        exact=exact,
        explained=best.explained,
        shared=best.shared,
        rival=None if rival is None else (rival.pose, share),
        findings=tuple(findings),
        problems=tuple(problems),
    )


def _told(pose: Pose2) -> str:
    """As ``--near`` takes it."""
    return f"{pose.x_m:.1f},{pose.y_m:.1f},{math.degrees(pose.theta_rad):.0f}"
