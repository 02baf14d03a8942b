"""How near a scan's points lie to the walls of a target, once and for many poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amr_slam.areas import within
from amr_slam.clouds import Cloud
from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array, Pose2
from amr_slam.registration import casting, kernels
from amr_slam.registration.alignment import Target


def clearance(source: Cloud) -> float:
    """How far in m from the nearest wall a noisy point must be to contradict free space."""
    return 0.25 + 3.0 * source.across_m


def counts(target: Target, moved_m: Array) -> NDArray[np.bool_]:
    """(n,) whether points (n, 2) in the target's frame lie where things may be landmarks."""
    return ~within(moved_m, target.zones)


def distances(target: Target, moved_m: Array) -> Array:
    """(n,) distance in m of points (n, 2) in the target's frame to the nearest wall, whichever
    way it faces: thin boards are mapped from one side and seen from the other. inf beyond
    reach."""
    lookup = target.lookup
    if ENABLED:
        return kernels.distances(
            moved_m, target.points_m, lookup.tiles, lookup.first, lookup.pool, lookup.layout
        )
    out = np.full(len(moved_m), np.inf)
    step = np.array([-lookup.cell_m, 0.0, lookup.cell_m])
    for shift in np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2):
        row = lookup.rows(moved_m + shift, np.zeros_like(moved_m))
        np.minimum(out, _distance(target, moved_m, row), out=out)
    return out


def scores(source: Cloud, target: Target, poses: Array, scale_m: float) -> Array:
    """(k,) mean fit of the scan at each of poses (k, 3): 1 on a wall, falling to 0 at
    ``scale_m``; -1 in space that was seen free."""
    lookup = target.lookup
    if ENABLED:
        return kernels.fit_scores(
            source.points_m,
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
    px, py = source.points_m.T
    moved = np.stack([c * px - s * py + poses[:, 0:1], s * px + c * py + poses[:, 1:2]], axis=2)
    distance = _distance(target, moved, lookup.rows(moved, np.zeros_like(moved)))
    fits = distance < scale_m
    wrong = ~fits & lookup.seen_free(moved) & (distance > clearance(source))
    return np.asarray((np.where(fits, 1.0 - distance / scale_m, 0.0) - wrong) @ share)


def beyond_walls(source: Cloud, target: Target, pose: Pose2) -> Array:
    """(n,) how much farther in m each beam went than the target's first wall in its way; -inf
    where there is none."""
    beams = source.points_m - source.origins_m
    reach = np.hypot(beams[:, 0], beams[:, 1])
    directions = (beams / np.maximum(reach, 1e-9)[:, None]) @ pose.rotation.T
    origins = pose @ source.origins_m
    to_wall = casting.ranges(target, origins, directions, float(reach.max()) + 1.0)
    return np.asarray(reach - to_wall)


def _distance(target: Target, moved: Array, rows: NDArray[np.int32]) -> Array:
    off = moved - target.points_m[rows]
    return np.where(rows >= 0, np.hypot(off[..., 0], off[..., 1]), np.inf)
