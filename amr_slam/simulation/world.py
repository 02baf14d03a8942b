"""The one type of simulated worlds, and how far a point in it is from everything solid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from amr_slam.geometry import Array, readonly
from amr_slam.simulation.shapes import distance_to_segments, odd_crossings

# Points are looked at together by square tiles of this size.
_TILE_M = 2.0
# Fewer points or edges than this are not worth sorting into tiles.
_FEW_POINTS = 64
_FEW_EDGES = 48


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
        if len(points_m) < _FEW_POINTS or len(edges) < _FEW_EDGES:
            return _clearance(points_m, edges, self.segments_m, self.table_tops_m)
        result = np.empty(len(points_m))
        for rows, low, high in _tiles(points_m):
            result[rows] = _clearance(
                points_m[rows],
                _nearest_to_tile(edges, low, high),
                _right_of_tile(self.segments_m, low, high),
                _right_of_tile(self.table_tops_m, low, high),
            )
        return result


def _clearance(points: Array, edges: Array, walls: Array, table_tops: Array) -> Array:
    result = np.empty(len(points))
    for start in range(0, len(points), 2048):  # bounds the memory of the point-edge table
        part = points[start : start + 2048]
        # Things are disjoint and inside the room: a free point sees an odd number of walls.
        free = odd_crossings(part, walls) & ~odd_crossings(part, table_tops)
        distance = distance_to_segments(part, edges)
        result[start : start + 2048] = np.where(free, distance, -distance)
    return result


def _tiles(points: Array) -> list[tuple[np.ndarray[tuple[int], np.dtype[np.int64]], Array, Array]]:
    """Rows of the points of each occupied tile, with the box (low, high) about these points."""
    tile = np.floor((points - points.min(axis=0)) / _TILE_M).astype(np.int64)
    key = tile[:, 1] * (int(tile[:, 0].max()) + 1) + tile[:, 0]
    order = np.argsort(key, kind="stable")
    bounds = np.flatnonzero(np.diff(key[order])) + 1
    return [
        (rows, points[rows].min(axis=0), points[rows].max(axis=0))
        for rows in np.split(order, bounds)
    ]


def _nearest_to_tile(edges: Array, low: Array, high: Array) -> Array:
    """The edges of which one is nearest to some point of the tile."""
    centre, radius = 0.5 * (low + high), 0.5 * float(np.hypot(*(high - low)))
    start, along = edges[:, :2], edges[:, 2:] - edges[:, :2]
    part = np.sum((centre - start) * along, axis=1) / np.sum(along * along, axis=1)
    foot = start + np.clip(part, 0.0, 1.0)[:, None] * along
    distance = np.hypot(*(foot - centre).T)
    near: Array = edges[distance <= distance.min() + 2.0 * radius + 1e-6]
    return near


def _right_of_tile(segments: Array, low: Array, high: Array) -> Array:
    """The segments that a ray towards +x from some point of the tile may cross."""
    x1, y1, x2, y2 = segments.T
    crosses = (np.minimum(y1, y2) <= high[1]) & (np.maximum(y1, y2) >= low[1])
    right: Array = segments[crosses & (np.maximum(x1, x2) >= low[0])]
    return right
