"""What a scan's points tell of its pose, without what the noise of the walls' normals feigns."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from amr_slam.geometry import Array

# Neighbouring normals are taken from the same points: about this many count as one.
_SHARED: Final = 20.0


def of_points(scan_normals: Array, map_normals: Array, arms: Array, weights: Array) -> Array:
    """(3, 3) information of (x, y, theta) in units of one point's distance to its wall.

    ``scan_normals``, ``map_normals`` (n, 2) in the map frame, of the scan zero where unknown;
    ``arms`` (n, 2) from the robot to the points; ``weights`` (n,).

    A noisy normal n + e makes information where there is none: its square n n' grows by e e',
    along a corridor at every point. Scan and map err apart from each other, so the products of
    their normals are right on average; what chance may still leave in them is taken off.
    """
    known = np.any(scan_normals != 0.0, axis=1) & (weights > 0.0)
    scan_normals = np.where(known[:, None], scan_normals, map_normals)
    product = (_lines(scan_normals, arms) * weights[:, None]).T @ _lines(map_normals, arms)
    product = 0.5 * (product + product.T)
    count = float(weights.sum())
    if not known.any() or count <= 0.0:
        return np.asarray(product)
    turn = scan_normals[:, 1] * map_normals[:, 0] - scan_normals[:, 0] * map_normals[:, 1]
    spread = 1.4826 * float(np.median(np.abs(turn[known])))
    chance = 0.5 * spread**2 * math.sqrt(_SHARED / max(count, _SHARED))
    x, y = arms[:, 0], arms[:, 1]
    east, north = weights @ x, weights @ y
    any_way = np.array(
        [
            [count, 0.0, -north],
            [0.0, count, east],
            [-north, east, weights @ (x * x + y * y)],
        ]
    )
    values, axes = np.linalg.eigh(product - chance * any_way)
    return np.asarray((axes * np.maximum(values, 1e-6 * count)) @ axes.T)


def _lines(normals: Array, arms: Array) -> Array:
    """(n, 3) derivatives of the points' distances to walls with these normals."""
    lever = normals[:, 1] * arms[:, 0] - normals[:, 0] * arms[:, 1]
    return np.column_stack([normals, lever])
