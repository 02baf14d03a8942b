"""A map in another frame: the same walls, space and scans, moved as one rigid body."""

from __future__ import annotations

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.map.grid import SparseGrid
from amr_slam.map.pointmap import PointMap


def moved(known: PointMap, new_from_old: Pose2) -> PointMap:
    """The map in another frame: each pose in it becomes ``new_from_old @ pose``.

    It is made anew of the rays that are kept, at their moved poses: cells of a turned grid do not
    fall one into one. What only scans saw whose rays were forgotten is moved cell by cell: wall
    points, normals and counts go where they belong, and points that come to lie in one cell become
    one. ``new_from_old`` must be finite.
    """
    poses = [new_from_old @ pose for _, pose in known.path]
    told = known.rebuilt([pose for _, pose in known.path])
    fresh = known.rebuilt(poses)
    _carry(known, told, fresh, new_from_old)
    fresh.path = [(stamp_ns, pose) for (stamp_ns, _), pose in zip(known.path, poses, strict=True)]
    fresh.layers = known.layers.moved(new_from_old)
    fresh.noises_m, fresh.rays = list(known.noises_m), list(known.rays)
    fresh.revision += 1
    return fresh


def carry_forgotten(known: PointMap, fresh: PointMap, new_from_old: Pose2) -> None:
    """Bring into ``fresh``, moved cell by cell, what only such scans of ``known`` have seen whose
    rays were forgotten."""
    if not all(len(rays) for rays in known.rays):
        told = known.rebuilt([pose for _, pose in known.path])
        _carry(known, told, fresh, new_from_old)


def _carry(known: PointMap, told: PointMap, fresh: PointMap, new_from_old: Pose2) -> None:
    """``told``: ``known`` as its rays alone make it."""
    _move_walls(known.walls, told.walls, fresh.walls, new_from_old)
    _move_space(known.space, told.space, fresh.space, new_from_old)


def _move_walls(old: SparseGrid, told: SparseGrid, new: SparseGrid, new_from_old: Pose2) -> None:
    """Cells that ``told`` lacks. For the columns of the sums see docs/map-format.md."""
    sums = old.sums.astype(np.float64)
    points = sums[:, 1:3] / sums[:, :1]
    rest = told.find(told.keys_of(points)) < 0
    if not rest.any():
        return
    sums, points = sums[rest], new_from_old @ np.asarray(points[rest])
    twice = Pose2(0.0, 0.0, 2.0 * new_from_old.theta_rad)
    turned = np.column_stack(
        [
            sums[:, 0],
            points * sums[:, :1],
            sums[:, 3:5] @ twice.rotation.T,
            sums[:, 5:7] @ new_from_old.rotation.T,
            sums[:, 7],
        ]
    )
    new.add(new.keys_of(points), turned)


def _move_space(old: SparseGrid, told: SparseGrid, new: SparseGrid, new_from_old: Pose2) -> None:
    """Asked is what was at the centre of each new cell, so that no seen cell is left a hole."""
    rest = told.find(told.keys_of(old.centres())) < 0
    if not rest.any():
        return
    corners = 0.5 * old.cell_m * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1], [0, 0]], dtype=float)
    spread: Array = (old.centres()[rest][:, None, :] + corners).reshape(-1, 2)
    keys = np.unique(new.keys_of(new_from_old @ spread))
    row = old.find(old.keys_of(new_from_old.inverse() @ new.centres(keys)))
    lacking = (row >= 0) & (new.find(keys) < 0)
    new.add(keys[lacking], old.sums[row[lacking]])
