"""Polygons and polylines on the floor. Needs numpy only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, readonly

_AT_ONCE: Final = 2_000_000
"""Points times edges that are looked at in one go."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Area:
    """A polygon with a name."""

    name: str
    corners_m: Array
    """(n, 2) in the map frame, in order around it; read-only."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners_m", readonly(self.corners_m))


def within(points_m: Array | NDArray[np.float32], areas: Sequence[Area]) -> NDArray[np.bool_]:
    """(n,) whether points (n, 2) lie in any of the areas."""
    inside = np.zeros(len(points_m), dtype=np.bool_)
    for area in areas:
        inside |= inside_of(points_m, area.corners_m)
    return inside


def inside_of(points_m: Array | NDArray[np.float32], corners_m: Array) -> NDArray[np.bool_]:
    """(n,) whether points (n, 2) lie in a polygon (k, 2): a ray from them crosses its edges an odd
    number of times."""
    inside = np.zeros(len(points_m), dtype=np.bool_)
    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    near = np.flatnonzero(np.all((points_m >= low) & (points_m <= high), axis=1))
    x0, y0 = corners_m.T
    x1, y1 = np.roll(corners_m, -1, axis=0).T
    rise = np.where(y1 == y0, 1.0, y1 - y0)  # a level edge is never crossed
    for rows in np.array_split(near, max(1, len(near) * len(corners_m) // _AT_ONCE)):
        x, y = points_m[rows].astype(np.float64).T[:, :, None]
        crossed = ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / rise)
        inside[rows] = crossed.sum(axis=1) % 2 == 1
    return inside


def crossing(corners_m: Array) -> tuple[int, int] | None:
    """Numbers of two edges of a polygon (k, 2) that touch or cross without being neighbours, or of
    two neighbours that run back over each other; None for a simple polygon. Edge i begins at
    corner i."""
    start, end = corners_m, np.roll(corners_m, -1, axis=0)
    k = len(corners_m)
    for i in range(k):
        j = np.arange(i + 1, k)
        meets = _meet(start[i], end[i], start[j], end[j])
        ahead, before = j == i + 1, (j == k - 1) & (i == 0)
        # Neighbours share a corner; they may not share more.
        meets[ahead] = _folds(start[i], end[i], end[(i + 1) % k])
        if k > 2:
            meets[before] = _folds(end[i], start[i], start[k - 1])
        found = np.flatnonzero(meets)
        if len(found):
            return i, int(j[found[0]])
    return None


def area_m2(corners_m: Array) -> float:
    """Area of a simple polygon (k, 2)."""
    x, y = (corners_m - corners_m[0]).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def along(corners_m: Array, spacing_m: float) -> tuple[Array, Array]:
    """Points (n, 2) along a polyline (k, 2), no farther apart than ``spacing_m``, and the unit
    normals (n, 2) to their left."""
    points, normals = [], []
    for start, end in pairwise(corners_m):
        way = end - start
        length = float(np.hypot(*way))
        if length == 0.0:
            continue
        steps = max(1, int(np.ceil(length / spacing_m)))
        part = (np.arange(steps) + 0.5) / steps
        points.append(start + part[:, None] * way)
        normals.append(np.broadcast_to([-way[1] / length, way[0] / length], (steps, 2)))
    return np.concatenate([np.empty((0, 2)), *points]), np.concatenate([np.empty((0, 2)), *normals])


def length_m(corners_m: Array) -> float:
    """Length of a polyline (k, 2)."""
    return float(np.hypot(*np.diff(corners_m, axis=0).T).sum())


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Positive where c lies to the left of the way from a to b."""
    ab, ac = b - a, c - a
    return np.asarray(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])


def _meet(a: Array, b: Array, c: Array, d: Array) -> NDArray[np.bool_]:
    """(n,) whether the segment a b meets segments c d, each (n, 2)."""
    abc, abd, cda, cdb = _turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)
    cross = (np.sign(abc) * np.sign(abd) <= 0) & (np.sign(cda) * np.sign(cdb) <= 0)
    low, high = np.minimum(a, b), np.maximum(a, b)
    overlap = np.all((np.maximum(c, d) >= low) & (np.minimum(c, d) <= high), axis=-1)
    return np.asarray(cross & overlap)


def _folds(before: Array, corner: Array, after: Array) -> bool:
    """Whether the way turns back on itself at a corner."""
    back, on = before - corner, after - corner
    return bool(_turn(corner, before, after) == 0.0 and back @ on > 0.0)
