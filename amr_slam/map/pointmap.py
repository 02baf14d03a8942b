"""The map: a cloud of wall points with normals, and the space that rays passed through."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, cast

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.map import effective
from amr_slam.map.deconvolution import Deconvolution
from amr_slam.map.grid import SparseGrid
from amr_slam.map.layers import LayerKind, Layers
from amr_slam.map.provenance import Imported, Reframing
from amr_slam.map.rays import Rays, forget, needs_room, pack
from amr_slam.map.strokes import carved, wall_values
from amr_slam.map.ties import no_ties
from amr_slam.registration import field, rdnm
from amr_slam.registration.alignment import Target
from amr_slam.registration.field import Field, FieldParams
from amr_slam.registration.rdnm import Packed, RdnmParams


@dataclass(frozen=True, slots=True, kw_only=True)
class MapParams:
    """Cells, and what counts as wall or as free."""

    cell_m: Annotated[float, Gt(0.0), Le(1.0)] = 0.05
    """One map point at most per cell of this size: the mean of what fell into it."""
    free_cell_m: Annotated[float, Gt(0.0), Le(1.0)] = 0.1
    """Cells in which rays that passed and rays that ended are counted."""
    ray_margin_m: Annotated[float, Ge(0.0)] = 0.15
    """A ray is evidence of free space only up to this much before its end."""
    vanish_ratio: Annotated[float, Gt(0.0)] = 4.0
    """A point whose cell was passed this many times as often as hit is taken for gone."""
    noisy_m: Annotated[float, Gt(0.0)] = 0.02
    """Scans noisier than this leave bands, not lines: walls are thinned."""
    thin: bool = True
    """False keeps the band (the paper's union of scans)."""


# Where noise across the walls is more than this many cells, cells of twice the side hold as much.
# So many scans must tell so: the change is for good.
_COARSER, _COARSER_SCANS = 2.8, 5
# Sums over a cell's points: weight; by weight x, y, cos 2phi, sin 2phi of the normal, sight x, y;
# number.
_CHANNELS = 8
# So many scans are drawn at a time: what is kept meanwhile stays small.
_BATCH = 32
_SIGHT_M = 25.0


class PointMap:
    """Grows by each accepted scan; answers what registration asks.

    Walls are sums per cell: a normal is summed as its double angle, so that a thin board seen
    from both sides keeps its direction, and points to where it was seen from. Free space is
    counted once per scan and cell.
    """

    def __init__(self, params: MapParams, name: str = "map") -> None:
        self.params = params
        self.name = name
        self._walls = SparseGrid(params.cell_m, _CHANNELS)
        # Scans that passed, scans that ended.
        self._space = SparseGrid(params.free_cell_m, 2, counts=True)
        self.path: list[tuple[int, Pose2]] = []
        """(stamp ns, map_from_base) of each scan that the map is made of."""
        self.noises_m: list[float] = []
        """Noise of each of these scans."""
        self.rays: list[Rays] = []
        """What each of these scans saw; nothing where it was forgotten for the memory's sake."""
        self.reframings: tuple[Reframing, ...] = ()
        """How its frame became what it is, oldest first; none where a run's start is the origin."""
        self.imported: Imported | None = None
        """The picture that it began as, if another program made it."""
        self.layers = Layers()
        """What people have drawn over it. Changed by :meth:`edit` only."""
        self.ties = no_ties()
        """The pose graph of the path's scans, as far as one is known."""
        self._undrawn = 0  # the newest scans of the path that walls and space lack yet
        self.revision = 0
        """+1 with each insertion and edit: what is derived from the map holds for one revision."""
        self._deconvolution: Deconvolution | None = None
        self._changed: tuple[Array, Array] | None = None  # corners of what it does not know yet
        self._latest: tuple[int, Target] | None = None
        self._whole: tuple[int, Target] | None = None
        self._landmarks: tuple[int, Target] | None = None
        self._places: dict[tuple[float, float], tuple[int, Array]] = {}
        self._signatures: tuple[int, RdnmParams, Array, Packed] | None = None
        self._field: tuple[int, FieldParams, Field] | None = None

    def __len__(self) -> int:
        return len(self.walls)

    @property
    def walls(self) -> SparseGrid:
        """Sums over the points of each cell, of all scans."""
        self._draw_appended()
        return self._walls

    @property
    def space(self) -> SparseGrid:
        """How many scans passed each cell, and how many ended in it."""
        self._draw_appended()
        return self._space

    def __copy__(self) -> PointMap:
        """With grids in common, so nothing may be left to be drawn into them by one of the two."""
        self._draw_appended()
        fresh = PointMap.__new__(PointMap)
        vars(fresh).update(vars(self))
        return fresh

    # -- growing ---------------------------------------------------------------------------

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
            walls = SparseGrid(2.0 * cell_m, _CHANNELS)
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

    # -- asking ----------------------------------------------------------------------------

    @property
    def sigma_m(self) -> float:
        """Noise of the scans that the map is made of: their median, as clutter looks like noise."""
        return float(np.median(self.noises_m)) if self.noises_m else 0.0

    @property
    def across_m(self) -> float:
        """Noise of these scans' points across the walls: their median too."""
        return float(np.median([rays.across_m for rays in self.rays])) if self.rays else 0.0

    @property
    def error_m(self) -> float:
        """How far its walls may lie from where it has them, all together: no scan tells that."""
        return 0.0 if self.imported is None else self.imported.error_m

    @property
    def spacing_m(self) -> float:
        """Distance of neighbouring points along a wall."""
        return self.params.cell_m if self.imported is None else self.imported.resolution_m

    def surfaces(self) -> Target:
        """All walls, those in zones where nothing is a landmark included: the map for people."""
        return self._whole_target()

    def target(self, centre: Pose2 | None = None, radius_m: float = _SIGHT_M) -> Target:
        """The wall points (all, or within ``radius_m`` of a pose) to register against.

        All of them come settled; near a pose, the walls of noisy scans are as good as the last
        scan left them, so that each scan costs little.
        """
        zones = self.layers.areas(LayerKind.ZONE)
        if centre is not None:
            near = self._near_target(centre, radius_m)
            return effective.landmarks(near, zones) if zones else near
        if not zones:
            return self._whole_target()
        if self._landmarks is None or self._landmarks[0] != self.revision:
            self._landmarks = self.revision, effective.landmarks(self._whole_target(), zones)
        return self._landmarks[1]

    def _near_target(self, centre: Pose2, radius_m: float) -> Target:
        if self._thins():
            latest = self._latest_target()
            near = _near(latest.points_m, centre, radius_m)
            free = latest.free_m[_near(latest.free_m, centre, radius_m)]
            points_m, normals = latest.points_m[near], latest.normals[near]
            return replace(latest, points_m=points_m, normals=normals, free_m=free)
        near = _near(self.walls.centres(), centre, radius_m)
        free_m = self._free_cells()
        found = self._in_space(
            self._plain(np.flatnonzero(near)), free_m[_near(free_m, centre, radius_m)]
        )
        if not self.layers:
            return found
        near = _near(found.points_m, centre, radius_m)  # walls are drawn anywhere
        return replace(found, points_m=found.points_m[near], normals=found.normals[near])

    def _thins(self) -> bool:
        """Whether walls are lines found in bands (noisy scans), or the cells' mean points."""
        return self.params.thin and self.sigma_m > self.params.noisy_m

    def _whole_target(self, *, growing: bool = False) -> Target:
        if self._whole is None or self._whole[0] != self.revision:
            everything = np.arange(len(self.walls))
            walls = self._settled(growing=growing) if self._thins() else self._plain(everything)
            self._whole = (self.revision, self._in_space(walls, self._free_cells()))
        return self._whole[1]

    def _latest_target(self, *, growing: bool = True) -> Target:
        """All walls, at the cost of one scan where :meth:`_whole_target` settles them anew."""
        for known in (self._whole, self._latest):
            if known is not None and known[0] == self.revision:
                return known[1]
        if self._deconvolution is None or not self._thins():
            return self._whole_target(growing=growing)
        if self._changed is not None and self._deconvolution.fits(self.walls, self.across_m):
            ridges = self._deconvolution.follow(self.walls, self.across_m, *self._changed)
            self._changed = None
            self._latest = (self.revision, self._in_space(self._lines(ridges), self._free_cells()))
            return self._latest[1]
        return self._whole_target(growing=growing)

    def _settled(self, *, growing: bool) -> Target:
        """The thin walls; ``growing``: what follows them with the next scan is kept too, which a
        map that is only localized in has no use for."""
        deconvolution = Deconvolution(self.params.cell_m)
        if not deconvolution.fits(self.walls, self.across_m):
            return self._plain(np.arange(len(self.walls)))
        ridges = deconvolution.settle(self.walls, self.across_m)
        self._deconvolution, self._changed = deconvolution if growing else None, None
        return self._lines(ridges)

    def _lines(self, ridges: Array) -> Target:
        here = ~self._vanished(ridges[:, :2])
        return Target(points_m=ridges[here, :2], normals=ridges[here, 2:], spacing_m=self.spacing_m)

    def _free_cells(self) -> Array:
        """Centres (k, 2) of the cells that more rays passed than ended in."""
        return self.space.centres()[self.space.sums[:, 0] > self.space.sums[:, 1]]

    def _in_space(self, walls: Target, free_m: Array) -> Target:
        there = replace(walls, sigma_m=self.sigma_m, free_m=free_m, cell_m=self.space.cell_m)
        return effective.edited(there, self.layers) if self.layers else there

    def _plain(self, rows: NDArray[np.intp]) -> Target:
        """The mean points of these wall cells."""
        sums = self.walls.sums[rows]
        count = np.maximum(sums[:, 0:1], 1e-9)
        points = sums[:, 1:3] / count
        here = ~self._vanished(points)
        sums, count, points = sums[here], count[here], points[here]
        direction = 0.5 * np.arctan2(sums[:, 4], sums[:, 3])
        # Cells in which the directions disagree (corners, clutter) have no normal.
        agreed = np.hypot(sums[:, 3], sums[:, 4]) > 0.4 * count[:, 0]
        normals = np.stack([np.cos(direction), np.sin(direction)], axis=1)
        normals = np.where(np.sum(normals * sums[:, 5:7], axis=1)[:, None] < 0.0, -normals, normals)
        return Target(
            points_m=points,
            normals=np.where(agreed[:, None], normals, 0.0),
            spacing_m=self.spacing_m,
        )

    def _vanished(self, points: Array) -> NDArray[np.bool_]:
        """Which wall points (n, 2) later scans looked through: people, opened doors."""
        cell = self.space.find(self.space.keys_of(points))
        passed = np.where(cell >= 0, self.space.sums[cell, 0], 0.0)
        ended = np.where(cell >= 0, self.space.sums[cell, 1], 0.0)
        return np.asarray(passed > self.params.vanish_ratio * np.maximum(ended, 1.0))

    def places(self, spacing_m: float, robot_radius_m: float) -> Array:
        """Grid points (m, 2) every ``spacing_m`` on seen-free cells where the robot fits.

        Algorithm 2, line 3, with "points removed where the AMR would not fit".
        """
        cached = self._places.get((spacing_m, robot_radius_m))
        if cached is None or cached[0] != self.revision:
            cached = self.revision, self._find_places(spacing_m, robot_radius_m)
            self._places[spacing_m, robot_radius_m] = cached
        return cached[1]

    def _find_places(self, spacing_m: float, robot_radius_m: float) -> Array:
        cells = self._free_cells()
        if not len(cells):
            return np.empty((0, 2))
        grid = SparseGrid(spacing_m, 1)
        grid.add(grid.keys_of(cells), np.ones((len(cells), 1)))
        # A grid cell counts where a fair part of its area was seen free.
        enough = 0.3 * (spacing_m / self.space.cell_m) ** 2
        centres = grid.centres()[grid.sums[:, 0] >= enough]
        walls = self._latest_target(growing=False)
        if len(walls):
            clearance = np.asarray(
                walls.tree.query(centres, distance_upper_bound=robot_radius_m)[0]
            )
            centres = centres[~np.isfinite(clearance)]
        return np.asarray(centres)

    def signatures(
        self, spacing_m: float, robot_radius_m: float, params: RdnmParams
    ) -> tuple[Array, Packed]:
        """(places (m, 2), their packed RDN signatures (m, sections)), once per revision."""
        places = self.places(spacing_m, robot_radius_m)
        cached = self._signatures
        if cached is None or cached[:2] != (self.revision, params) or cached[2] is not places:
            walls = self.target()
            h = rdnm.of_map(walls, places, params)
            cached = self._signatures = (self.revision, params, places, h)
        return cached[2], cached[3]

    def field(self, params: FieldParams) -> Field:
        """The walls' likelihood field, computed once per revision."""
        cached = self._field
        if cached is None or cached[:2] != (self.revision, params):
            built = field.build(self.target(), params)
            cached = self._field = (self.revision, params, built)
        return cached[2]

    def area_m2(self) -> float:
        """Floor area that was seen free."""
        return len(self._free_cells()) * self.space.cell_m**2

    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) of the walls in m; zeros for an empty map."""
        drawn = [one.corners_m for one in self.layers.active if one.kind is LayerKind.WALL]
        centres = np.concatenate([self.walls.centres(), *drawn])
        if not len(centres):
            return 0.0, 0.0, 0.0, 0.0
        low, high = centres.min(axis=0), centres.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _near(points: Array | NDArray[np.float32], centre: Pose2, radius_m: float) -> NDArray[np.bool_]:
    distance = np.hypot(points[:, 0] - centre.x_m, points[:, 1] - centre.y_m)
    return np.asarray(distance <= min(radius_m, math.inf))
