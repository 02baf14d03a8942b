"""Seeded laboratory worlds of about 200 m2, after figure 2 of the paper."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation.shapes import box, edges, pillar, polygon_area, table_legs
from amr_slam.simulation.world import World

_AREA_M2 = 200.0
# Room to pass between things that stand freely: two robots' widths less a hand.
_AISLE_M = 1.3
_ATTEMPTS = 400


def laboratory(seed: int) -> World:
    """A room of 200 m2 with alcoves, machines along the walls and in the middle, tables on legs
    and pillars. The same seed gives the same world."""
    rng = np.random.default_rng(seed)
    outline = _outline(rng)
    world = World(
        seed=seed, outline_m=outline, segments_m=edges(outline), table_tops_m=np.empty((0, 4))
    )
    for _ in range(int(rng.integers(4, 7))):
        world = _with_machine_at_wall(world, rng)
    for _ in range(int(rng.integers(2, 5))):
        size = rng.uniform([1.2, 0.8], [2.6, 1.5])
        world = _with_free_standing(world, rng, box(*size))
    for _ in range(int(rng.integers(2, 4))):
        size = rng.uniform([1.2, 0.7], [2.0, 0.9])
        world = _with_free_standing(world, rng, box(*size), is_table=True)
    for _ in range(int(rng.integers(2, 5))):
        world = _with_free_standing(world, rng, pillar(rng))
    return world


def _outline(rng: np.random.Generator) -> Array:
    """A rectangle whose sides step in and out, scaled to the wanted area."""
    width = rng.uniform(15.0, 18.0)
    height = 190.0 / width
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    points: list[Array] = []
    for corner, following in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = following - corner
        length = math.hypot(*along)
        along = along / length
        outward = np.array([along[1], -along[0]])
        points.append(corner)
        # One step in each half keeps the steps apart; those of two sides cannot meet either.
        for low, high in ((2.5, 0.5 * length), (0.5 * length, length - 2.5)):
            if rng.random() < 0.2:
                continue
            a, b = low + rng.uniform(0.0, 0.35, 2) * (high - low)
            begin, end = a, high - (b - low)
            depth = rng.uniform(0.8, 1.8) * (1.0 if rng.random() < 0.6 else -0.6)
            points += [
                corner + begin * along,
                corner + begin * along + depth * outward,
                corner + end * along + depth * outward,
                corner + end * along,
            ]
    outline = np.array(points)
    return outline * math.sqrt(_AREA_M2 / polygon_area(outline))


def _with_machine_at_wall(world: World, rng: np.random.Generator) -> World:
    walls = edges(world.outline_m)
    for _ in range(_ATTEMPTS):
        x1, y1, x2, y2 = walls[rng.integers(len(walls))]
        length = math.hypot(x2 - x1, y2 - y1)
        width, depth = rng.uniform([1.0, 0.5], [3.0, 1.2])
        if length < width + 0.4:
            continue
        along_m = rng.uniform(0.5 * width + 0.2, length - 0.5 * width - 0.2)
        gap_m = rng.uniform(0.05, 0.2)
        wall = Pose2(x1, y1, math.atan2(y2 - y1, x2 - x1))
        shape = wall @ (box(width, depth) + np.array([along_m, gap_m + 0.5 * depth]))
        if np.min(world.clearance(_boundary(shape))) > 0.04:
            return _with_solid(world, shape)
    return world


def _with_free_standing(
    world: World, rng: np.random.Generator, shape: Array, *, is_table: bool = False
) -> World:
    low, high = world.outline_m.min(axis=0), world.outline_m.max(axis=0)
    for _ in range(_ATTEMPTS):
        turn = rng.integers(2) * 0.5 * math.pi + rng.normal(0.0, 0.1)
        x, y = rng.uniform(low, high)
        polygon = Pose2(x, y, turn) @ shape
        if np.min(world.clearance(_boundary(polygon))) > _AISLE_M:
            return _with_table(world, polygon) if is_table else _with_solid(world, polygon)
    return world


def _with_solid(world: World, polygon: Array) -> World:
    return World(
        seed=world.seed,
        outline_m=world.outline_m,
        segments_m=np.concatenate([world.segments_m, edges(polygon)]),
        table_tops_m=world.table_tops_m,
    )


def _with_table(world: World, polygon: Array) -> World:
    return World(
        seed=world.seed,
        outline_m=world.outline_m,
        segments_m=np.concatenate([world.segments_m, *table_legs(polygon)]),
        table_tops_m=np.concatenate([world.table_tops_m, edges(polygon)]),
    )


def _boundary(polygon: Array) -> Array:
    """Points on the edges, dense enough that nothing but a table leg fits between."""
    fractions = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None, None]
    following = np.roll(polygon, -1, axis=0)
    return np.concatenate(
        [(polygon + fractions * (following - polygon)).reshape(-1, 2), polygon.mean(axis=0)[None]]
    )
