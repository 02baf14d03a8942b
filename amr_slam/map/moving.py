"""A map in another frame: the same walls, space and scans, moved as one rigid body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.map.grid import SparseGrid
from amr_slam.map.pointmap import PointMap


def moved(known: PointMap, new_from_old: Pose2) -> PointMap:
    """The map in another frame: each pose in it becomes ``new_from_old @ pose``.

    Where all scans' rays are kept, the map is made anew of them at their moved poses. Where some
    were forgotten, the sums of the wall cells are moved: each wall point, normal and count goes
    where it belongs, and points that come to lie in one cell become one. Cells of the space take
    what the old cell at their centre had. ``new_from_old`` must be finite.
    """
    poses = [new_from_old @ pose for _, pose in known.path]
    if known.rays and all(len(rays) for rays in known.rays):
        return known.rebuilt(poses)
    fresh = PointMap(known.params, known.name)
    fresh.reframings = known.reframings
    fresh.path = [(stamp_ns, pose) for (stamp_ns, _), pose in zip(known.path, poses, strict=True)]
    fresh.noises_m = list(known.noises_m)
    fresh.rays = [replace(rays) for rays in known.rays]
    _move_walls(known.walls, fresh.walls, new_from_old)
    _move_space(known.space, fresh.space, new_from_old)
    fresh.revision = 1
    return fresh


def _move_walls(old: SparseGrid, new: SparseGrid, new_from_old: Pose2) -> None:
    """For the columns of the sums see docs/map-format.md."""
    if not len(old):
        return
    sums = old.sums.astype(np.float64)
    points = new_from_old @ np.asarray(sums[:, 1:3] / sums[:, :1])
    turned = sums.copy()
    turned[:, 1:3] = points * sums[:, :1]
    turned[:, 3:5] = sums[:, 3:5] @ Pose2(0.0, 0.0, 2.0 * new_from_old.theta_rad).rotation.T
    turned[:, 5:7] = sums[:, 5:7] @ new_from_old.rotation.T
    new.add(new.keys_of(points), turned)
    new.sums = new.sums.astype(old.sums.dtype, copy=False)


def _move_space(old: SparseGrid, new: SparseGrid, new_from_old: Pose2) -> None:
    """A turned grid's cells do not fall one into one: asked is what was at each new cell's
    centre, so that no seen cell is left a hole."""
    if not len(old):
        return
    corners = 0.5 * old.cell_m * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1], [0, 0]], dtype=float)
    spread: Array = (old.centres()[:, None, :] + corners).reshape(-1, 2)
    keys = np.unique(new.keys_of(new_from_old @ spread))
    row = old.find(old.keys_of(new_from_old.inverse() @ new.centres(keys)))
    new.keys = keys[row >= 0]
    new.sums = old.sums[row[row >= 0]].copy()
