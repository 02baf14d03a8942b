"""Walls of noisy scans are bands as thick as the noise: find the line inside the band."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from amr_slam.geometry import Array
from amr_slam.map.grid import SparseGrid


def thin_walls(
    points_m: Array,
    weights: Array,
    sights: Array,
    sigma_m: float,
    cell_m: float,
    iterations: int = 4,
) -> tuple[Array, Array]:
    """Ridge of a weighted point band: thin points (k, 2) and unit normals (k, 2).

    ``sights`` (n, 2): weighted directions from which the points were seen; normals face them.

    Each point climbs to the ridge of the point density: it moves along the local normal to the
    weighted mean of its neighbours (Gaussian weights of bandwidth max(0.08 m, sigma)), a mean
    shift constrained to the direction of least spread (Ozertem and Erdogmus 2011, locally
    defined principal curves, with the local covariance as Hessian). Then one point a cell stays.
    Points with little support (the outermost of the band) are dropped.
    """
    bandwidth = max(0.08, sigma_m)
    moving = points_m.copy()
    source = cKDTree(points_m)
    normals = np.zeros_like(points_m)
    support: Array = np.zeros(len(points_m))
    for _ in range(iterations):
        pairs = cKDTree(moving).sparse_distance_matrix(
            source, 2.5 * bandwidth, output_type="coo_matrix"
        )
        row, col = np.asarray(pairs.row), np.asarray(pairs.col)
        weight = weights[col] * np.exp(-0.5 * (pairs.data / bandwidth) ** 2)
        size = len(moving)
        support = np.asarray(np.bincount(row, weights=weight, minlength=size), dtype=np.float64)
        total = np.maximum(support, 1e-12)
        mean = np.stack(
            [np.bincount(row, weight * points_m[col, k], size) / total for k in (0, 1)], axis=1
        )
        offset = points_m[col] - mean[row]
        xx = np.bincount(row, weight * offset[:, 0] ** 2, size)
        yy = np.bincount(row, weight * offset[:, 1] ** 2, size)
        xy = np.bincount(row, weight * offset[:, 0] * offset[:, 1], size)
        along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
        normals = np.stack([-np.sin(along), np.cos(along)], axis=1)
        climb = np.sum((mean - moving) * normals, axis=1, keepdims=True)
        moving = moving + climb * normals
        seen_from = np.stack(
            [np.bincount(row, weight / weights[col] * sights[col, k], size) for k in (0, 1)], axis=1
        )
        away = np.sum(normals * seen_from, axis=1, keepdims=True) < 0.0
        normals = np.where(away, -normals, normals)
    supported = support > 0.25 * np.median(support) if len(support) else np.empty(0, np.bool_)
    return _one_per_cell(moving[supported], normals[supported], support[supported], cell_m)


def _one_per_cell(
    points: Array, normals: Array, support: Array, cell_m: float
) -> tuple[Array, Array]:
    grid = SparseGrid(cell_m, 5)
    columns = np.column_stack([np.ones(len(points)), points, normals])
    grid.add(grid.keys_of(points), columns * support[:, None])
    weight = np.maximum(grid.sums[:, 0:1], 1e-12)
    length = np.maximum(np.linalg.norm(grid.sums[:, 3:5], axis=1, keepdims=True), 1e-12)
    return grid.sums[:, 1:3] / weight, grid.sums[:, 3:5] / length
