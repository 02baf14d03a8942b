"""Seeded laboratory worlds of about 200 m2, after figure 2 of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from amr_slam.geometry import Array, Pose2, readonly

_AREA_M2 = 200.0
# Room to pass between things that stand freely: two robots' widths less a hand.
_AISLE_M = 1.3
_ATTEMPTS = 400


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """A closed room with solid things in it, everything made of straight walls."""

    seed: int
    outline_m: Array
    """(k, 2) read-only: corners of the room, counter-clockwise."""
    segments_m: Array
    """(n, 4) read-only, x1 y1 x2 y2: every wall that a scanner sees, outline included."""
    table_tops_m: Array
    """(m, 4) read-only: edges above the scan plane. Not seen, and not to be driven under."""

    def __post_init__(self) -> None:
        for name in ("outline_m", "segments_m", "table_tops_m"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def clearance(self, points_m: Array) -> Array:
        """(n,) distance in m from each of (n, 2) points to the nearest wall or table edge;
        negative inside of solid things, below tables and outside of the room."""
        edges = np.concatenate([self.segments_m, self.table_tops_m])
        result = np.empty(len(points_m))
        for start in range(0, len(points_m), 2048):  # bounds the memory of the point-edge table
            part = points_m[start : start + 2048]
            # Things are disjoint and inside the room: a free point sees an odd number of walls.
            free = _odd_crossings(part, self.segments_m) & ~_odd_crossings(part, self.table_tops_m)
            distance = _distance_to_segments(part, edges)
            result[start : start + 2048] = np.where(free, distance, -distance)
        return result


def laboratory(seed: int) -> World:
    """A room of 200 m2 with alcoves, machines along the walls and in the middle, tables on legs
    and pillars. The same seed gives the same world."""
    rng = np.random.default_rng(seed)
    outline = _outline(rng)
    world = World(
        seed=seed, outline_m=outline, segments_m=_edges(outline), table_tops_m=np.empty((0, 4))
    )
    for _ in range(int(rng.integers(4, 7))):
        world = _with_machine_at_wall(world, rng)
    for _ in range(int(rng.integers(2, 5))):
        size = rng.uniform([1.2, 0.8], [2.6, 1.5])
        world = _with_free_standing(world, rng, _box(*size))
    for _ in range(int(rng.integers(2, 4))):
        size = rng.uniform([1.2, 0.7], [2.0, 0.9])
        world = _with_free_standing(world, rng, _box(*size), is_table=True)
    for _ in range(int(rng.integers(2, 5))):
        world = _with_free_standing(world, rng, _pillar(rng))
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
    return outline * math.sqrt(_AREA_M2 / _polygon_area(outline))


def _with_machine_at_wall(world: World, rng: np.random.Generator) -> World:
    walls = _edges(world.outline_m)
    for _ in range(_ATTEMPTS):
        x1, y1, x2, y2 = walls[rng.integers(len(walls))]
        length = math.hypot(x2 - x1, y2 - y1)
        width, depth = rng.uniform([1.0, 0.5], [3.0, 1.2])
        if length < width + 0.4:
            continue
        along_m = rng.uniform(0.5 * width + 0.2, length - 0.5 * width - 0.2)
        gap_m = rng.uniform(0.05, 0.2)
        wall = Pose2(x1, y1, math.atan2(y2 - y1, x2 - x1))
        box = wall @ (_box(width, depth) + np.array([along_m, gap_m + 0.5 * depth]))
        if np.min(world.clearance(_boundary(box))) > 0.04:
            return _with_solid(world, box)
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
        segments_m=np.concatenate([world.segments_m, _edges(polygon)]),
        table_tops_m=world.table_tops_m,
    )


def _with_table(world: World, polygon: Array) -> World:
    centre = polygon.mean(axis=0)
    legs = [_edges(_box(0.06, 0.06) + corner + 0.1 * (centre - corner)) for corner in polygon]
    return World(
        seed=world.seed,
        outline_m=world.outline_m,
        segments_m=np.concatenate([world.segments_m, *legs]),
        table_tops_m=np.concatenate([world.table_tops_m, _edges(polygon)]),
    )


def _box(width: float, depth: float) -> Array:
    return np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * [width / 2, depth / 2]


def _pillar(rng: np.random.Generator) -> Array:
    """Square or round, 30 to 50 cm."""
    size = rng.uniform(0.3, 0.5)
    if rng.random() < 0.5:
        return _box(size, size)
    angles = np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)
    return 0.5 * size * np.column_stack([np.cos(angles), np.sin(angles)])


def _edges(polygon: Array) -> Array:
    return np.hstack([polygon, np.roll(polygon, -1, axis=0)])


def _boundary(polygon: Array) -> Array:
    """Points on the edges, dense enough that nothing but a table leg fits between."""
    fractions = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None, None]
    following = np.roll(polygon, -1, axis=0)
    return np.concatenate(
        [(polygon + fractions * (following - polygon)).reshape(-1, 2), polygon.mean(axis=0)[None]]
    )


def _polygon_area(polygon: Array) -> float:
    x, y = polygon.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _distance_to_segments(points: Array, segments: Array) -> Array:
    """(n,) distance from each of (n, 2) points to the nearest of (m, 4) segments."""
    start, edge = segments[:, :2], segments[:, 2:] - segments[:, :2]
    x = points[:, None, 0] - start[:, 0]
    y = points[:, None, 1] - start[:, 1]
    along = (x * edge[:, 0] + y * edge[:, 1]) / np.sum(edge * edge, axis=1)
    along = np.clip(along, 0.0, 1.0)
    x -= along * edge[:, 0]
    y -= along * edge[:, 1]
    nearest: Array = np.sqrt(np.min(x * x + y * y, axis=1))
    return nearest


def _odd_crossings(points: Array, segments: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(n,) True where a ray towards +x crosses an odd number of segments."""
    x1, y1, x2, y2 = segments.T
    x, y = points[:, :1], points[:, 1:]
    spans = (y1 > y) != (y2 > y)
    rise = np.where(y1 == y2, 1.0, y2 - y1)
    left_of = x < x1 + (y - y1) / rise * (x2 - x1)
    odd: np.ndarray[tuple[int], np.dtype[np.bool_]] = np.sum(spans & left_of, axis=1) % 2 == 1
    return odd
