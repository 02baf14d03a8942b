"""Polygons and straight walls: what worlds are built of and measured by."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.geometry import Array


def box(width: float, depth: float) -> Array:
    """(4, 2) corners in m of a rectangle about the origin, width along x."""
    return np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * [width / 2, depth / 2]


def box_between(x1: float, y1: float, x2: float, y2: float) -> Array:
    """(4, 2) corners in m of an upright rectangle, counter-clockwise where x1 < x2 and y1 < y2."""
    return np.array([[x1, y1], [x2, y1], [x2, y2], [x1, y2]])


def pillar(rng: np.random.Generator) -> Array:
    """Corners of a square or round pillar of 30 to 50 cm about the origin."""
    size = rng.uniform(0.3, 0.5)
    if rng.random() < 0.5:
        return box(size, size)
    angles = np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)
    return 0.5 * size * np.column_stack([np.cos(angles), np.sin(angles)])


def edges(polygon: Array) -> Array:
    """(k, 4) x1 y1 x2 y2 of the edges of a polygon of (k, 2) corners."""
    return np.hstack([polygon, np.roll(polygon, -1, axis=0)])


def table_legs(polygon: Array) -> list[Array]:
    """The four legs of 6 cm below a table top, each as (4, 4) edges."""
    centre = polygon.mean(axis=0)
    return [edges(box(0.06, 0.06) + corner + 0.1 * (centre - corner)) for corner in polygon]


def along_edges(polygon: Array, spacing_m: float) -> Array:
    """(n, 2) points on the edges of a polygon, at most ``spacing_m`` apart, corners included."""
    points: list[Array] = []
    for corner, following in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        steps = max(1, math.ceil(math.hypot(*(following - corner)) / spacing_m))
        points.append(corner + np.arange(steps)[:, None] / steps * (following - corner))
    return np.concatenate(points)


def polygon_area(polygon: Array) -> float:
    """Area in m2 of a polygon of (k, 2) corners, negative if these go clockwise."""
    x, y = polygon.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def distance_to_segments(points: Array, segments: Array) -> Array:
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


def odd_crossings(points: Array, segments: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(n,) True where a ray towards +x crosses an odd number of segments."""
    x1, y1, x2, y2 = segments.T
    x, y = points[:, :1], points[:, 1:]
    spans = (y1 > y) != (y2 > y)
    rise = np.where(y1 == y2, 1.0, y2 - y1)
    left_of = x < x1 + (y - y1) / rise * (x2 - x1)
    odd: np.ndarray[tuple[int], np.dtype[np.bool_]] = np.sum(spans & left_of, axis=1) % 2 == 1
    return odd
