"""A simulated drive through a laboratory under ceiling cameras, and plans of its building."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from amr_slam.aligning import Track
from amr_slam.geometry import Array, Pose2
from amr_slam.recording import Trajectory
from amr_slam.simulation import (
    CeilingCameras,
    PathFollower,
    SimulatedRobot,
    World,
    laboratory,
    plan_tour,
)

CAMERAS = CeilingCameras()
SITE_FROM_MAP, MARKER = CAMERAS.site_from_map, CAMERAS.base_from_marker
_FINER = 8
"""Plans are drawn with pixels so many times as small, then reduced."""


@functools.cache
def drive(seed: int = 3) -> Trajectory:
    """Once round, at 50 Hz; begins at the map's origin."""
    world = laboratory(seed)
    tour = plan_tour(world)
    robot = SimulatedRobot(
        world=world, world_from_map=tour.world_from_map, scanners=(), seed=seed, start_ns=10**9
    )
    follower = PathFollower(tour.path_in_map_m)
    stamps, poses = [], []
    while follower.laps < 1.0:
        robot.advance(*follower.steer(robot.map_from_base))
        stamps.append(robot.stamp_ns)
        poses.append(robot.map_from_base.as_array())
    return Trajectory(stamps_ns=np.array(stamps, dtype=np.int64), poses=np.array(poses))


def seen_by_cameras(
    known: Trajectory, rng: np.random.Generator, *, headings: bool = True, **how: Any
) -> tuple[Track, NDArray[np.bool_]]:
    """What they say of the drive, and which poses are another robot's."""
    seen, wrong = replace(CAMERAS, **how).watch(known, rng)
    poses = seen.poses.copy()
    if not headings:
        poses[:, 2] = np.nan
    return Track(stamps_ns=seen.stamps_ns, poses=poses), wrong


def draw_plan(
    world: World,
    site_from_world: Pose2,
    out: Path,
    *,
    resolution_m: float = 0.05,
    doors: int = 3,
    thick_m: float = 0.2,
) -> Pose2:
    """An architect's plan: thick outer walls with openings for doors, no furniture. Returns where
    its lower left corner is in the site's frame."""
    rng = np.random.default_rng(0)
    corners = site_from_world @ np.array(world.outline_m)
    low, high = corners.min(axis=0) - 1.0, corners.max(axis=0) + 1.0
    width, height = (int(side) for side in np.ceil((high - low) / resolution_m))
    fine_m = resolution_m / _FINER

    def pixel(point: Array) -> tuple[float, float]:
        x, y = (point - low) / fine_m
        return float(x), float(_FINER * height - y)

    picture = Image.new("L", (_FINER * width, _FINER * height), 255)
    pen = ImageDraw.Draw(picture)
    outline = [pixel(corner) for corner in corners]
    pen.line([*outline, outline[0]], fill=0, width=round(2.0 * thick_m / fine_m))
    pen.polygon(outline, fill=255)
    sides = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    for number in rng.permutation(len(sides))[:doors]:
        start, end = sides[number]
        length_m = float(np.hypot(*(end - start)))
        if length_m > 2.0:
            along = (end - start) / length_m
            middle = start + rng.uniform(0.3, 0.7) * (end - start)
            opening = [pixel(middle - 0.6 * along), pixel(middle + 0.6 * along)]
            pen.line(opening, fill=255, width=round(3.0 * thick_m / fine_m))
    picture.reduce(_FINER).save(out)
    return Pose2(float(low[0]), float(low[1]), 0.0)
