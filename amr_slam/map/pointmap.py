"""The map: a cloud of wall points with normals, and the space that rays passed through."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.map.grid import SparseGrid
from amr_slam.map.thinning import thin_walls
from amr_slam.registration import field, rdnm
from amr_slam.registration.alignment import Target
from amr_slam.registration.field import Field, FieldParams
from amr_slam.registration.rdnm import RdnmParams


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
    noisy_m: Annotated[float, Gt(0.0)] = 0.075
    """Scans noisier than this (one and a half cells) leave bands, not lines: walls are thinned."""
    thin: bool = True
    """False keeps the band (the paper's union of scans)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """What the map says about a scan's points, row-aligned with them."""

    free: NDArray[np.bool_]
    """(n,) the point lies where rays have passed and no wall is near: a contradiction."""
    known: NDArray[np.bool_]
    """(n,) the map knows the place at all: free or near a wall."""


# Nearer than this, a point counts in full.
_NEAR_M = 3.0
# Points this near to a wall lie in a known place.
_REACH_M = 0.3
# Sums over a cell's points: weight; by weight x, y, cos 2phi, sin 2phi of the normal, sight x, y.
_CHANNELS = 7
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
        self.walls = SparseGrid(params.cell_m, _CHANNELS)
        self.space = SparseGrid(params.free_cell_m, 2)  # scans that passed, scans that ended
        self.path: list[tuple[int, Pose2]] = []
        """(stamp ns, map_from_base) of each scan that the map is made of."""
        self.noises_m: list[float] = []
        """Noise of each of these scans."""
        self.revision = 0
        """+1 with each insertion: what is derived from the map is valid for one revision."""
        self._whole: tuple[int, Target] | None = None
        self._places: tuple[int, float, float, Array] | None = None
        self._signatures: tuple[int, RdnmParams, Array, Array] | None = None
        self._field: tuple[int, FieldParams, Field] | None = None

    def __len__(self) -> int:
        return len(self.walls)

    # -- growing ---------------------------------------------------------------------------

    def insert(self, cloud: Cloud, map_from_base: Pose2) -> None:
        """Add one accepted scan at its pose."""
        points = map_from_base @ cloud.points_m
        origins = map_from_base @ cloud.origins_m
        normals = cloud.normals @ map_from_base.rotation.T
        known = cloud.has_normal
        double = 2.0 * np.arctan2(normals[:, 1], normals[:, 0])
        sight = origins - points
        sight = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
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
        reach = np.linalg.norm(points - origins, axis=1)
        values *= np.clip((_NEAR_M / np.maximum(reach, 1e-3)) ** 2, 0.02, 1.0)[:, None]
        self.walls.add(self.walls.keys_of(points), values)
        self._carve(points, origins, cloud.sigma_m)
        self.path.append((cloud.stamp_ns, map_from_base))
        self.noises_m.append(cloud.sigma_m)
        self.revision += 1

    def _carve(self, points: Array, origins: Array, sigma_m: float) -> None:
        """Count the cells that this scan's rays passed through, and those in which they ended."""
        ends = np.unique(self.space.keys_of(points))
        margin = self.params.ray_margin_m + 3.0 * sigma_m
        reach = np.linalg.norm(points - origins, axis=1)
        steps = np.arange(0.0, float(reach.max(initial=0.0)), 0.7 * self.space.cell_m)
        along = steps[None, :] < (reach - margin)[:, None]
        ray, step = np.nonzero(along)
        direction = (points - origins) / np.maximum(reach, 1e-9)[:, None]
        samples = origins[ray] + steps[step][:, None] * direction[ray]
        passed = np.setdiff1d(np.unique(self.space.keys_of(samples)), ends, assume_unique=True)
        keys = np.concatenate([passed, ends])
        flags = np.zeros((len(keys), 2))
        flags[: len(passed), 0] = 1.0
        flags[len(passed) :, 1] = 1.0
        self.space.add(keys, flags)

    # -- asking ----------------------------------------------------------------------------

    @property
    def sigma_m(self) -> float:
        """Noise of the scans that the map is made of: their median, as clutter looks like noise."""
        return float(np.median(self.noises_m)) if self.noises_m else 0.0

    def target(self, centre: Pose2 | None = None, radius_m: float = _SIGHT_M) -> Target:
        """The wall points (all, or within ``radius_m`` of a pose) to register against."""
        noisy = self.params.thin and self.sigma_m > self.params.noisy_m
        if centre is None or noisy:
            whole = self._whole_target()
            if centre is None:
                return whole
            near = _near(whole.points_m, centre, radius_m)
            walls = replace(whole, points_m=whole.points_m[near], normals=whole.normals[near])
        else:
            near = _near(self.walls.centres(), centre, radius_m)
            walls = self._target_of(np.flatnonzero(near))
        free = self._free_cells()
        return self._in_space(walls, free[_near(free, centre, radius_m)])

    def _whole_target(self) -> Target:
        if self._whole is None or self._whole[0] != self.revision:
            walls = self._target_of(np.arange(len(self.walls)))
            self._whole = (self.revision, self._in_space(walls, self._free_cells()))
        return self._whole[1]

    def _free_cells(self) -> Array:
        """Centres (k, 2) of the cells that more rays passed than ended in."""
        return self.space.centres()[self.space.sums[:, 0] > self.space.sums[:, 1]]

    def _in_space(self, walls: Target, free_m: Array) -> Target:
        return replace(walls, sigma_m=self.sigma_m, free_m=free_m, cell_m=self.space.cell_m)

    def _target_of(self, rows: NDArray[np.intp]) -> Target:
        rows = rows[~self._vanished(rows)]
        sums = self.walls.sums[rows]
        count = np.maximum(sums[:, 0:1], 1e-9)
        points = sums[:, 1:3] / count
        sigma = self.sigma_m
        if self.params.thin and sigma > self.params.noisy_m:
            points, normals = thin_walls(
                points, count[:, 0], sums[:, 5:7], sigma, self.params.cell_m
            )
            return Target(points_m=points, normals=normals, spacing_m=self.params.cell_m)
        direction = 0.5 * np.arctan2(sums[:, 4], sums[:, 3])
        # Cells in which the directions disagree (corners, clutter) have no normal.
        agreed = np.hypot(sums[:, 3], sums[:, 4]) > 0.4 * count[:, 0]
        normals = np.stack([np.cos(direction), np.sin(direction)], axis=1)
        normals = np.where(np.sum(normals * sums[:, 5:7], axis=1)[:, None] < 0.0, -normals, normals)
        return Target(
            points_m=points,
            normals=np.where(agreed[:, None], normals, 0.0),
            spacing_m=self.params.cell_m,
        )

    def _vanished(self, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Which wall cells later scans looked through: people, opened doors."""
        centres = self.walls.sums[rows, 1:3] / np.maximum(self.walls.sums[rows, 0:1], 1e-9)
        cell = self.space.find(self.space.keys_of(centres))
        passed = np.where(cell >= 0, self.space.sums[cell, 0], 0.0)
        ended = np.where(cell >= 0, self.space.sums[cell, 1], 0.0)
        return np.asarray(passed > self.params.vanish_ratio * np.maximum(ended, 1.0))

    def known(self, points_m: Array, distance_m: Array) -> Known:
        """What the map knows at points (n, 2) of the map frame, ``distance_m`` (n,) from the
        nearest wall point."""
        cell = self.space.find(self.space.keys_of(points_m))
        if len(self.space):
            passed = np.where(cell >= 0, self.space.sums[cell, 0], 0.0)
            ended = np.where(cell >= 0, self.space.sums[cell, 1], 0.0)
        else:
            passed = ended = np.zeros(len(points_m))
        clear = 0.25 + 3.0 * self.sigma_m
        free = (passed > ended) & (distance_m > clear)
        return Known(free=free, known=free | (distance_m <= _REACH_M))

    def places(self, spacing_m: float, robot_radius_m: float) -> Array:
        """Grid points (m, 2) every ``spacing_m`` on seen-free cells where the robot fits.

        Algorithm 2, line 3, with "points removed where the AMR would not fit".
        """
        cached = self._places
        if cached is None or cached[:3] != (self.revision, spacing_m, robot_radius_m):
            found = self._find_places(spacing_m, robot_radius_m)
            cached = self._places = (self.revision, spacing_m, robot_radius_m, found)
        return cached[3]

    def _find_places(self, spacing_m: float, robot_radius_m: float) -> Array:
        cells = self._free_cells()
        if not len(cells):
            return np.empty((0, 2))
        grid = SparseGrid(spacing_m, 1)
        grid.add(grid.keys_of(cells), np.ones((len(cells), 1)))
        # A grid cell counts where a fair part of its area was seen free.
        enough = 0.3 * (spacing_m / self.space.cell_m) ** 2
        centres = grid.centres()[grid.sums[:, 0] >= enough]
        walls = self._whole_target()
        if len(walls):
            clearance = np.asarray(
                walls.tree.query(centres, distance_upper_bound=robot_radius_m)[0]
            )
            centres = centres[~np.isfinite(clearance)]
        return np.asarray(centres)

    def signatures(
        self, spacing_m: float, robot_radius_m: float, params: RdnmParams
    ) -> tuple[Array, Array]:
        """(places (m, 2), their RDN signatures (m, sections)), computed once per revision."""
        places = self.places(spacing_m, robot_radius_m)
        cached = self._signatures
        if cached is None or cached[:2] != (self.revision, params) or cached[2] is not places:
            walls = self._whole_target()
            h = rdnm.of_map(walls, places, params)
            cached = self._signatures = (self.revision, params, places, h)
        return cached[2], cached[3]

    def field(self, params: FieldParams) -> Field:
        """The walls' likelihood field, computed once per revision."""
        cached = self._field
        if cached is None or cached[:2] != (self.revision, params):
            built = field.build(self._whole_target(), params)
            cached = self._field = (self.revision, params, built)
        return cached[2]

    def area_m2(self) -> float:
        """Floor area that was seen free."""
        return len(self._free_cells()) * self.space.cell_m**2

    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) of the walls in m; zeros for an empty map."""
        if not len(self.walls):
            return 0.0, 0.0, 0.0, 0.0
        centres = self.walls.centres()
        low, high = centres.min(axis=0), centres.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _near(points: Array, centre: Pose2, radius_m: float) -> NDArray[np.bool_]:
    distance = np.hypot(points[:, 0] - centre.x_m, points[:, 1] - centre.y_m)
    return np.asarray(distance <= min(radius_m, math.inf))
