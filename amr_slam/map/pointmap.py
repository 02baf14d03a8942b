"""The map: a cloud of wall points with normals, and the space that rays passed through."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.map.grid import SparseGrid
from amr_slam.map.layers import Layers
from amr_slam.map.params import MapParams
from amr_slam.map.rays import forget, needs_room, pack
from amr_slam.map.seen import CHANNELS, SeenMap
from amr_slam.map.strokes import carved, wall_values

# Where noise across the walls is more than this many cells, cells of twice the side hold as much.
# So many scans must tell so: the change is for good.
_COARSER, _COARSER_SCANS = 2.8, 5
# So many scans are drawn at a time: what is kept meanwhile stays small.
_BATCH = 32


class PointMap(SeenMap):
    """Grows by each accepted scan; answers what registration asks."""

    def __init__(self, params: MapParams, name: str = "map") -> None:
        super().__init__(params, name)
        self._undrawn = 0  # the newest scans of the path that walls and space lack yet

    def __copy__(self) -> PointMap:
        """With grids in common, so nothing may be left to be drawn into them by one of the two."""
        self._draw_appended()
        fresh = PointMap.__new__(PointMap)
        vars(fresh).update(vars(self))
        return fresh

    def insert(self, cloud: Cloud, map_from_base: Pose2) -> None:
        """Add one accepted scan at its pose."""
        self._draw_appended()
        self._note(cloud, map_from_base)
        self._draw([(cloud, map_from_base)])
        self._forget()

    def append(self, cloud: Cloud, map_from_base: Pose2) -> None:
        """Add one accepted scan at its pose, to be drawn when somebody asks for walls or space:
        until then it costs the same however large the map is. Its rays are rounded."""
        self._note(cloud, map_from_base)
        self._undrawn += 1
        self.revision += 1

    def append_all(self, other: PointMap, poses: Sequence[Pose2]) -> None:
        """Add all scans of another map, each at its pose (map_from_base) in this one, to be drawn
        like those of :meth:`append`. What only forgotten scans saw does not come along."""
        path = zip(other.path, poses, strict=True)
        self.path += [(stamp_ns, pose) for (stamp_ns, _), pose in path]
        self.noises_m += other.noises_m
        self.rays += other.rays
        self._undrawn += len(other.path)
        self.revision += 1

    def _draw_appended(self) -> None:
        waiting, self._undrawn = self._undrawn, 0
        for first in range(len(self.path) - waiting, len(self.path), _BATCH):
            rows = range(first, min(first + _BATCH, len(self.path)))
            self._draw(
                [
                    (self.rays[row].cloud(self.path[row][0], self.noises_m[row]), self.path[row][1])
                    for row in rows
                    if len(self.rays[row])
                ]
            )
        if waiting:
            self._forget()  # not before all are drawn: how much is kept goes by the area that is

    def rebuilt(self, poses: Sequence[Pose2]) -> PointMap:
        """A map of the same scans, each at its new pose: one for each scan of ``path``, in its
        order. What only a forgotten scan saw is not in it."""
        fresh = PointMap(self.params, self.name)
        fresh.reframings, fresh.imported = self.reframings, self.imported
        fresh.merged = self.merged
        fresh.layers, fresh.ties = self.layers, self.ties
        path = zip(self.path, poses, strict=True)
        fresh.path = [(stamp_ns, pose) for (stamp_ns, _), pose in path]
        fresh.noises_m, fresh.rays = list(self.noises_m), list(self.rays)
        fresh._undrawn = len(fresh.path)
        return fresh

    def edit(self, layers: Layers) -> None:
        """Lay these over the map, in place of those that are there."""
        self.layers = layers
        self.revision += 1

    def copied(self) -> PointMap:
        """A map of its own with the same content."""
        fresh = copy.copy(self)
        fresh.path, fresh.noises_m = list(self.path), list(self.noises_m)
        fresh.rays = list(self.rays)
        grids = {"_walls": copy.deepcopy(self._walls), "_space": copy.deepcopy(self._space)}
        vars(fresh).update(grids, _places={}, _deconvolution=None)
        return fresh

    def move(self, poses: Sequence[Pose2]) -> None:
        """Become the map that :meth:`rebuilt` gives: whoever holds this one sees its scans move."""
        fresh = self.rebuilt(poses)
        fresh.revision = self.revision + 1
        vars(self).update(vars(fresh))

    def _note(self, cloud: Cloud, map_from_base: Pose2) -> None:
        self.path.append((cloud.stamp_ns, map_from_base))
        self.noises_m.append(cloud.sigma_m)
        self.rays.append(pack(cloud))

    def _draw(self, scans: Sequence[tuple[Cloud, Pose2]]) -> None:
        """Count walls and space of scans at their poses."""
        if not scans:
            return
        placed = [(pose @ cloud.points_m, pose @ cloud.origins_m) for cloud, pose in scans]
        points, origins = (np.concatenate(part) for part in zip(*placed, strict=True))
        normals = np.concatenate([cloud.normals @ pose.rotation.T for cloud, pose in scans])
        known = np.concatenate([cloud.has_normal for cloud, _ in scans])
        self.walls.add(self.walls.keys_of(points), wall_values(points, origins, normals, known))
        self._carve(placed, [cloud.sigma_m for cloud, _ in scans])
        if len(points):
            low, high = self._changed or (points.min(axis=0), points.max(axis=0))
            self._changed = (
                np.minimum(low, points.min(axis=0)),
                np.maximum(high, points.max(axis=0)),
            )
        self._coarsen()
        self.revision += 1

    def _forget(self) -> None:
        if needs_room(self.rays):
            forget(self.rays, [pose for _, pose in self.path], self.area_m2())

    def _coarsen(self) -> None:
        """Keep the walls of noisy scans in half the digits, and in cells of twice the side where
        noise leaves nothing to be told apart in them."""
        if len(self.rays) < _COARSER_SCANS or not self._thins():
            return
        cell_m = self.walls.cell_m
        if self.across_m > _COARSER * cell_m and 2.0 * cell_m <= self.params.free_cell_m:
            walls = SparseGrid(2.0 * cell_m, CHANNELS)
            walls.add(walls.keys_of(self.walls.centres()), self.walls.sums)
            self.params = replace(self.params, cell_m=walls.cell_m)
            self._walls, self._deconvolution = walls, None
        self.walls.sums = cast("Array", self.walls.sums.astype(np.float32, copy=False))

    def _carve(self, placed: Sequence[tuple[Array, Array]], sigmas_m: Sequence[float]) -> None:
        """Count the cells that each scan's rays passed through, and those in which they ended.

        ``placed``: points and origins (n, 2) of each scan in the map's frame.
        """
        keys: list[NDArray[np.int64]] = []
        counts: list[Array] = []
        for (points, origins), sigma_m in zip(placed, sigmas_m, strict=True):
            margin = self.params.ray_margin_m + 3.0 * sigma_m
            passed, ends = carved(points, origins, margin, self.space)
            flags = np.zeros((len(passed) + len(ends), 2))
            flags[: len(passed), 0] = 1.0
            flags[len(passed) :, 1] = 1.0
            keys += [passed, ends]
            counts.append(flags)
        self.space.add(np.concatenate(keys), np.concatenate(counts))
