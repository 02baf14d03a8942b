"""How far a map's walls are along a ray."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array
from amr_slam.registration import kernels
from amr_slam.registration.alignment import Target

# A wall is as thick as the gaps between its points must not let a ray through.
_HIT_M: Final = 0.06


def ranges(target: Target, origins_m: Array, directions: Array, range_max_m: float) -> Array:
    """(n,) distance in m along each ray to the first wall it meets, inf where there is none.

    ``origins_m`` (n, 2) and unit ``directions`` (n, 2) in the target's frame.
    """
    if not len(target):
        return np.full(len(origins_m), np.inf)
    if ENABLED:
        lookup = target.lookup
        return kernels.cast_rays(
            origins_m,
            directions,
            range_max_m,
            target.points_m,
            target.normals,
            lookup.tiles,
            lookup.first,
            lookup.pool,
            lookup.layout,
            lookup.reach_m,
            _HIT_M,
        )
    return _ranges_in_numpy(target, origins_m, directions, range_max_m)


def _ranges_in_numpy(
    target: Target, origins: Array, directions: Array, range_max_m: float
) -> Array:
    """What :func:`kernels.cast_rays` does, all rays a step at a time."""
    lookup = target.lookup
    out = np.full(len(origins), np.inf)
    active = np.arange(len(origins))
    t: Array = np.zeros(len(origins))
    while len(active):
        at = origins[active] + t[active, None] * directions[active]
        _, _, inside = lookup.cells(at)
        row = lookup.rows(at, np.zeros_like(at))
        known = row >= 0
        to_wall = target.points_m[row] - at
        distance = np.hypot(to_wall[:, 0], to_wall[:, 1])
        met = known & (distance <= _HIT_M)
        step = np.maximum(distance - 0.75 * lookup.cell_m, 0.5 * _HIT_M)
        step = np.where(known, step, lookup.reach_m - lookup.cell_m)
        step = np.where(inside, step, lookup.cell_m)
        if met.any():
            ray, normal = directions[active[met]], target.normals[row[met]]
            across = np.sum(normal * ray, axis=1)
            ahead = np.sum(to_wall[met] * ray, axis=1)
            to_line = np.sum(normal * to_wall[met], axis=1)
            steep = np.abs(across) > 0.3
            ahead = np.where(steep, to_line / np.where(steep, across, 1.0), ahead)
            ahead = np.clip(ahead, -_HIT_M, _HIT_M)
            out[active[met]] = np.maximum(t[active[met]] + ahead, 0.0)
        t[active] += step
        active = active[~met & (t[active] <= range_max_m)]
    return out
