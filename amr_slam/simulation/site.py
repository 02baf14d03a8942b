"""A world under construction: things are put where there is room for them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation.shapes import (
    along_edges,
    box,
    distance_to_segments,
    edges,
    odd_crossings,
    polygon_area,
    table_legs,
)
from amr_slam.simulation.world import World

# Points on the border of a new thing, for its distance from others: a table leg fits between.
_BORDER_M = 0.3
_ATTEMPTS = 60


class Site:
    """The outline, walls that may touch it and each other, and things that touch nothing."""

    def __init__(self, outline_m: Array, walls_m: Sequence[Array] = ()) -> None:
        """``outline_m``: (k, 2) counter-clockwise; ``walls_m``: polygons of (n, 2) corners."""
        self.outline_m = outline_m
        self._seen = np.concatenate([edges(outline_m), *(edges(wall) for wall in walls_m)])
        self._tops = np.empty((0, 4))
        self._kept_free: list[tuple[float, float, float]] = []

    @staticmethod
    def of(world: World) -> Site:
        """A world that is there already, to put more into."""
        site = Site(world.outline_m)
        site._seen, site._tops = world.segments_m, world.table_tops_m
        return site

    def keep_free(self, point_m: Array, radius_m: float) -> None:
        """Nothing will be put this near to a point (2,): before a door."""
        self._kept_free.append((float(point_m[0]), float(point_m[1]), radius_m))

    def take_over(self, room: Site) -> None:
        """All things that stand in a room of this one, without the room's outline."""
        self._seen = np.concatenate([self._seen, room._seen[len(room.outline_m) :]])
        self._tops = np.concatenate([self._tops, room._tops])

    def has_room(self, polygon: Array, gap_m: float) -> bool:
        """Whether a thing of (n, 2) corners lies inside, ``gap_m`` from everything else."""
        border = along_edges(polygon, _BORDER_M)
        middle = polygon.mean(axis=0)
        radius = float(np.hypot(*(polygon - middle).T).max())
        if self._kept_free:
            x, y, free = np.array(self._kept_free).T
            points = np.column_stack([x, y])
            away = distance_to_segments(points, edges(polygon))
            if np.any(away < free) or odd_crossings(points, edges(polygon)).any():
                return False
        others = np.concatenate([self._seen, self._tops])
        near_edges = others[_distance_to_boxes(others, middle) < radius + gap_m]
        if len(near_edges) and np.min(distance_to_segments(border, near_edges)) < gap_m:
            return False
        if odd_crossings(near_edges[:, :2], edges(polygon)).any():  # around something
            return False
        probe = middle[None]
        inside = odd_crossings(probe, self._seen) & ~odd_crossings(probe, self._tops)
        return bool(inside[0])

    def put(self, polygon: Array, *, is_table: bool = False) -> None:
        """A solid thing, or a table on legs, of (n, 2) corners; whether there is room or not."""
        if is_table:
            self._seen = np.concatenate([self._seen, *table_legs(polygon)])
            self._tops = np.concatenate([self._tops, edges(polygon)])
        else:
            self._seen = np.concatenate([self._seen, edges(polygon)])

    def put_rack(self, pose: Pose2, length_m: float, depth_m: float, filled: Array) -> None:
        """Posts with shelves above the scan plane, and pallets on the floor of some bays.

        ``filled``: (bays,) whether a pallet stands there, turned by a little.
        """
        bay = length_m / len(filled)
        parts = [edges(pose @ box(length_m, depth_m))]
        self._tops = np.concatenate([self._tops, *parts])
        posts = [
            pose @ (box(0.1, 0.1) + np.array([x, y]))
            for x in np.linspace(-0.5, 0.5, len(filled) + 1) * (length_m - 0.12)
            for y in (0.05 * 1.2 - 0.5 * depth_m, 0.5 * depth_m - 0.05 * 1.2)
        ]
        pallets = [
            pose
            @ (
                Pose2((i + 0.5) * bay - 0.5 * length_m, 0.0, float(turn))
                @ box(bay - 0.6, depth_m - 0.3)
            )
            for i, turn in enumerate(filled)
            if not math.isnan(turn)
        ]
        self._seen = np.concatenate([self._seen, *(edges(part) for part in [*posts, *pallets])])

    def scatter(
        self,
        rng: np.random.Generator,
        shape: Array,
        gap_m: float,
        *,
        is_table: bool = False,
        any_angle: bool = False,
    ) -> None:
        """Puts a shape somewhere where it has room, square to x and y within some degrees or at
        any angle; nowhere if no place is found."""
        low, high = self.outline_m.min(axis=0), self.outline_m.max(axis=0)
        for _ in range(_ATTEMPTS):
            turn = float(rng.integers(4) * 0.5 * math.pi + rng.normal(0.0, 0.1))
            if any_angle:
                turn = rng.uniform(-math.pi, math.pi)
            x, y = rng.uniform(low, high)
            polygon = Pose2(x, y, turn) @ shape
            if self.has_room(polygon, gap_m):
                self.put(polygon, is_table=is_table)
                return

    def at_wall(
        self,
        rng: np.random.Generator,
        room: Array,
        size_m: Array,
        gap_m: float = 1.0,
    ) -> None:
        """Puts a box with its back to a side of a room of (k, 2) corners, ``gap_m`` from all else
        on its other sides; nowhere if no place is found. ``size_m``: (2,) width and depth."""
        width, depth = (float(size) for size in size_m)
        for _ in range(_ATTEMPTS):
            x1, y1, x2, y2 = edges(room)[rng.integers(len(room))]
            length = math.hypot(x2 - x1, y2 - y1)
            if length < width + 0.4:
                continue
            along = rng.uniform(0.5 * width + 0.2, length - 0.5 * width - 0.2)
            away = rng.uniform(0.03, 0.2)
            wall = Pose2(x1, y1, math.atan2(y2 - y1, x2 - x1))
            polygon = wall @ (box(width, depth) + np.array([along, away + 0.5 * depth]))
            about = box(width + 2.0 * gap_m, depth + gap_m)
            about = wall @ (about + np.array([along, away + 0.5 * (depth + gap_m)]))
            if self.has_room(polygon, 0.02) and not self._any_within(about):
                self.put(polygon)
                return

    def _any_within(self, polygon: Array) -> bool:
        """Whether the edges of something lie in a box or cross it; corners of a room do not."""
        middle = polygon.mean(axis=0)
        radius = float(np.hypot(*(polygon - middle).T).max())
        others = np.concatenate([self._seen, self._tops])
        others = others[_distance_to_boxes(others, middle) < radius]
        parts = [
            part + np.linspace(0.0, 1.0, max(2, math.ceil(length / 0.1)))[:, None] * along
            for part, along, length in zip(
                others[:, :2],
                others[:, 2:] - others[:, :2],
                np.hypot(*(others[:, 2:] - others[:, :2]).T),
                strict=True,
            )
        ]
        return bool(parts) and bool(odd_crossings(np.concatenate(parts), edges(polygon)).any())

    def world(self, seed: int) -> World:
        """What has been built."""
        return World(
            seed=seed, outline_m=self.outline_m, segments_m=self._seen, table_tops_m=self._tops
        )


def _distance_to_boxes(segments: Array, point: Array) -> Array:
    """(n,) distance in m from a point to the upright box about each segment: a lower bound."""
    low = np.minimum(segments[:, :2], segments[:, 2:])
    high = np.maximum(segments[:, :2], segments[:, 2:])
    away = np.maximum(np.maximum(low - point, point - high), 0.0)
    distance: Array = np.hypot(away[:, 0], away[:, 1])
    return distance


def scaled(outline: Array, area_m2: float) -> Array:
    """The same polygon with the wanted area and its lower left corner in the origin."""
    grown: Array = outline * math.sqrt(area_m2 / polygon_area(outline))
    return np.array(grown - grown.min(axis=0))
