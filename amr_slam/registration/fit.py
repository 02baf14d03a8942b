"""How near a scan's points lie to the walls of a target, once and for many poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array
from amr_slam.registration import kernels
from amr_slam.registration.alignment import Target


def clearance(source: Cloud) -> float:
    """How far in m from the nearest wall a noisy point must be to contradict free space."""
    return 0.25 + 3.0 * source.across_m


def distances(target: Target, moved_m: Array, turned: Array) -> tuple[Array, Array]:
    """(n,), (n,) distance in m of points (n, 2) with normals (n, 2), both in the target's frame,
    to the nearest wall, and to the nearest that faces their way; inf beyond reach."""
    lookup = target.lookup
    if ENABLED:
        return kernels.look_around(
            moved_m,
            turned,
            target.points_m,
            lookup.tiles,
            lookup.first,
            lookup.pool,
            lookup.layout,
        )
    any_way, same_way = np.full(len(moved_m), np.inf), np.full(len(moved_m), np.inf)
    cell = lookup.cell_m
    for dy in (-cell, 0.0, cell):
        for dx in (-cell, 0.0, cell):
            for normals, best in ((np.zeros_like(turned), any_way), (turned, same_way)):
                row = lookup.rows(moved_m + np.array([dx, dy]), normals)
                off = moved_m - target.points_m[row]
                distance = np.where(row >= 0, np.hypot(off[:, 0], off[:, 1]), np.inf)
                np.minimum(best, distance, out=best)
    return any_way, same_way


def scores(source: Cloud, target: Target, poses: Array, scale_m: float) -> Array:
    """(k,) mean fit of the scan at each of poses (k, 3): 1 on a wall that faces the point's way,
    falling to 0 at ``scale_m``; -1 in space that was seen free."""
    lookup = target.lookup
    if ENABLED:
        return kernels.fit_scores(
            source.points_m,
            source.normals,
            source.weights,
            poses,
            target.points_m,
            lookup.tiles,
            lookup.first,
            lookup.pool,
            lookup.free,
            lookup.layout,
            scale_m,
            clearance(source),
        )
    share = source.weights / source.weights.sum()
    c, s = np.cos(poses[:, 2:3]), np.sin(poses[:, 2:3])
    (px, py), (nx, ny) = source.points_m.T, source.normals.T
    moved = np.stack([c * px - s * py + poses[:, 0:1], s * px + c * py + poses[:, 1:2]], axis=2)
    turned = np.stack([c * nx - s * ny, s * nx + c * ny], axis=2)
    alike = _distance(target, moved, lookup.rows(moved, turned))
    nearest = _distance(target, moved, lookup.rows(moved, np.zeros_like(turned)))
    fits = alike < scale_m
    wrong = ~fits & lookup.seen_free(moved) & (nearest > clearance(source))
    return np.asarray((np.where(fits, 1.0 - alike / scale_m, 0.0) - wrong) @ share)


def _distance(target: Target, moved: Array, rows: NDArray[np.int32]) -> Array:
    off = moved - target.points_m[rows]
    return np.where(rows >= 0, np.hypot(off[..., 0], off[..., 1]), np.inf)
