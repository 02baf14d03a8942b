"""What one scan adds to a map: points to its walls, rays to its space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amr_slam.compiled import ENABLED, jit
from amr_slam.geometry import Array
from amr_slam.map.grid import Keys, SparseGrid

# Nearer than this, a point counts in full.
_NEAR_M = 3.0
_STEP = 0.7
"""Of a cell, along a ray."""


def wall_values(points: Array, origins: Array, normals: Array, known: NDArray[np.bool_]) -> Array:
    """(n, channels) what each point adds to its wall cell; ``known`` (n,): whether its
    normal is."""
    double = 2.0 * np.arctan2(normals[:, 1], normals[:, 0])
    sight = origins - points
    reach = np.linalg.norm(sight, axis=1)
    sight = sight / np.maximum(reach, 1e-9)[:, None]
    values = np.stack(
        [
            np.ones(len(points)),
            points[:, 0],
            points[:, 1],
            np.where(known, np.cos(double), 0.0),
            np.where(known, np.sin(double), 0.0),
            sight[:, 0],
            sight[:, 1],
        ],
        axis=1,
    )
    # A near look at a wall outweighs a far one: its place and direction are known better.
    values *= np.clip((_NEAR_M / np.maximum(reach, 1e-3)) ** 2, 0.02, 1.0)[:, None]
    # ... but the noise of a point is the same at any distance.
    return np.hstack([values, np.ones((len(points), 1))])


def carved(
    points_m: Array, origins_m: Array, margin_m: float, grid: SparseGrid
) -> tuple[Keys, Keys]:
    """Keys of the cells passed, and of those ended in, each once and in order; what a ray ended in
    none has passed. Rays from ``origins_m`` (n, 2) to ``points_m`` (n, 2) count up to
    ``margin_m`` before their ends."""
    ends = np.unique(grid.keys_of(points_m))
    if not len(points_m):
        return ends, ends
    # Marked on a picture of what the scan saw: quicker than to sort all that was passed.
    corners = np.concatenate([points_m, origins_m])
    low = np.floor(corners.min(axis=0) / grid.cell_m) - 1.0
    high = np.floor(corners.max(axis=0) / grid.cell_m) + 1.0
    seen = np.zeros((high - low + 1.0).astype(np.int64), dtype=np.bool_)
    mark = _mark_loop if ENABLED else _mark_numpy
    mark(np.array(points_m), np.array(origins_m), margin_m, grid.cell_m, low, seen)
    middles = (np.argwhere(seen) + low + 0.5) * grid.cell_m
    return np.setdiff1d(grid.keys_of(middles), ends, assume_unique=True), ends


@jit
def _mark_loop(
    points: Array, origins: Array, margin: float, cell: float, low: Array, seen: NDArray[np.bool_]
) -> None:
    for ray in range(len(points)):
        x, y = origins[ray, 0], origins[ray, 1]
        dx, dy = points[ray, 0] - x, points[ray, 1] - y
        reach = np.sqrt(dx * dx + dy * dy)
        if reach <= margin:
            continue
        dx, dy = dx / reach, dy / reach
        for k in range(int(np.ceil((reach - margin) / (_STEP * cell)))):
            along = k * (_STEP * cell)
            column = int(np.floor((x + along * dx) / cell) - low[0])
            row = int(np.floor((y + along * dy) / cell) - low[1])
            seen[column, row] = True


def _mark_numpy(
    points: Array, origins: Array, margin: float, cell: float, low: Array, seen: NDArray[np.bool_]
) -> None:
    """What :func:`_mark_loop` does, all rays at once."""
    reach = np.sqrt(np.sum((points - origins) ** 2, axis=1))
    counts = np.ceil(np.maximum(reach - margin, 0.0) / (_STEP * cell))
    ray, step = np.nonzero(np.arange(int(counts.max(initial=0.0)))[None, :] < counts[:, None])
    direction = (points[ray] - origins[ray]) / reach[ray, None]
    samples = origins[ray] + step[:, None] * (_STEP * cell) * direction
    columns, rows = (np.floor(samples / cell) - low).astype(np.int64).T
    seen[columns, rows] = True
