"""Correspondence in constant time: a grid that knows the nearest wall point of each cell.

The grid has five layers: one of all points, and one for each of the four directions a wall may
face, so that the two sides of a thin board are told apart. Only the tiles near walls are stored.
The nearest of a cell is that of its centre: the nearest of a query, or its neighbour on the wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array
from amr_slam.registration import kernels, nearest

Rows = NDArray[np.intp]

TILE: Final = kernels.TILE
"""Cells along a tile's side."""
DIRECTIONS: Final = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""What the walls of each layer face; those of the first face any way."""
# A wall belongs to a layer if its normal is within 70 degrees of it: with queries within 45 of
# their layer, nearly all pairs that agree within 50 degrees can meet.
_WITHIN: Final = math.cos(math.radians(70.0))
# A map torn apart over kilometres gets coarser cells rather than all memory.
_MOST_CELLS: Final = 40_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lookup:
    """Row ``iy``, column ``ix`` is the cell [x0 + ix cell, x0 + (ix + 1) cell) and so on."""

    x0_m: float
    y0_m: float
    cell_m: float
    reach_m: float
    """Cells farther than this from all points know none."""
    tiles: NDArray[np.int32]
    """(5, ny / TILE, nx / TILE) the tile's number in ``pool``, or -1."""
    first: NDArray[np.int32]
    """(tiles,) the least row of the target's points that a tile knows."""
    pool: NDArray[np.uint16]
    """(tiles, TILE, TILE) rows of the target's points less the tile's first, or NONE."""
    free: NDArray[np.bool_]
    """(ny / 2, nx / 2) rays have passed here more often than they ended."""

    @property
    def layout(self) -> tuple[float, float, float]:
        """(x0, y0, cell) in m."""
        return self.x0_m, self.y0_m, self.cell_m

    def cells(self, points_m: Array) -> tuple[Rows, Rows, NDArray[np.bool_]]:
        """(iy, ix, inside) of points (..., 2); outside the grid the indices are 0."""
        ix = np.floor((points_m[..., 0] - self.x0_m) / self.cell_m)
        iy = np.floor((points_m[..., 1] - self.y0_m) / self.cell_m)
        ny, nx = self.tiles.shape[1] * TILE, self.tiles.shape[2] * TILE
        inside = (ix >= 0) & (iy >= 0) & (ix < nx) & (iy < ny)
        return (
            np.where(inside, iy, 0).astype(np.intp),
            np.where(inside, ix, 0).astype(np.intp),
            inside,
        )

    def rows(self, points_m: Array, normals: Array) -> NDArray[np.int32]:
        """Rows (...) of the nearest target points that face as ``normals`` (..., 2) do, any way
        where these are zero; -1 where there is none near."""
        iy, ix, inside = self.cells(points_m)
        tile = self.tiles[layers_of(normals), iy // TILE, ix // TILE]
        offset = self.pool[tile, iy % TILE, ix % TILE]
        known = inside & (tile >= 0) & (offset != kernels.NONE)
        return np.where(known, self.first[tile] + offset, np.int32(-1))

    def seen_free(self, points_m: Array) -> NDArray[np.bool_]:
        """(...) whether points (..., 2) lie where rays have passed."""
        iy, ix, inside = self.cells(points_m)
        return np.asarray(inside & self.free[iy // 2, ix // 2])


def layers_of(normals: Array) -> NDArray[np.int64]:
    """The layers (...) in which walls with these normals (..., 2) look for their like."""
    x, y = normals[..., 0], normals[..., 1]
    along_x = np.abs(x) >= np.abs(y)
    layer = np.where(along_x, np.where(x > 0.0, 1, 3), np.where(y > 0.0, 2, 4))
    return np.where((x == 0.0) & (y == 0.0), 0, layer)


def build(
    points_m: Array,
    normals: Array,
    free_m: NDArray[np.float32] | Array,
    free_cell_m: float,
    reach_m: float,
) -> Lookup:
    """The look-up of wall points (n, 2), n > 0, with normals (n, 2), and of the centres (k, 2)
    of cells of ``free_cell_m`` that were seen free. Its own cells are half of those.

    The points are sorted by x, so that the rows that meet in a tile lie close together. Raises
    ValueError where more than 65,534 points lie in a strip as wide as a tile and its reach.
    """
    strip_m = TILE * 0.5 * free_cell_m + 2.0 * reach_m
    ahead = np.searchsorted(points_m[:, 0], points_m[:, 0] + strip_m)
    if np.any(ahead - np.arange(len(points_m)) >= kernels.NONE):
        raise ValueError("too many wall points in one strip of the map")
    everything = np.concatenate([points_m, free_m])
    low = everything.min(axis=0) - reach_m
    high = everything.max(axis=0) + reach_m
    cell_m = 0.5 * free_cell_m
    while np.prod((high - low) / cell_m + 2.0 * TILE) > _MOST_CELLS:
        cell_m *= 2.0
    x0, y0 = (float(c) for c in np.floor(low / (2.0 * cell_m)) * 2.0 * cell_m)
    tx, ty = (int(size / (TILE * cell_m)) + 1 for size in high - [x0, y0])
    layout = (x0, y0, cell_m)
    find = nearest.nearest_points if ENABLED else _nearest_in_numpy
    tiles, first, pool = find(points_m, normals, layout, (ty, tx), reach_m, _WITHIN)
    free = np.zeros((ty * TILE // 2, tx * TILE // 2), dtype=np.bool_)
    index = np.floor((free_m - [x0, y0]) / (2.0 * cell_m)).astype(np.int64)
    free[index[:, 1], index[:, 0]] = True
    return Lookup(
        x0_m=x0, y0_m=y0, cell_m=cell_m, reach_m=reach_m, tiles=tiles, first=first, pool=pool,
        free=free
    )  # fmt: skip


def _nearest_in_numpy(
    points: Array,
    normals: Array,
    layout: tuple[float, float, float],
    shape: tuple[int, int],
    reach: float,
    within: float,
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.uint16]]:
    """What :func:`nearest.nearest_points` does, by k-d trees."""
    x0, y0, cell = layout
    ty, tx = shape
    tiles = np.full((5, ty, tx), -1, dtype=np.int32)
    first: list[int] = []
    pool: list[NDArray[np.uint16]] = []
    centre = (np.arange(TILE) + 0.5) * cell
    corners_y, corners_x = (side.ravel() for side in np.mgrid[:ty, :tx])
    middles = (np.column_stack([corners_x, corners_y]) + 0.5) * TILE * cell + [x0, y0]
    span = 0.5 * TILE * cell
    for layer, direction in enumerate(DIRECTIONS):
        rows = np.flatnonzero(normals @ direction >= (within if layer else 0.0))
        if not len(rows):
            continue
        tree = scipy.spatial.cKDTree(points[rows])
        near = tree.query(middles, distance_upper_bound=reach + 1.5 * span)[0]
        for k in np.flatnonzero(np.isfinite(near)):
            x = x0 + corners_x[k] * TILE * cell + centre
            y = y0 + corners_y[k] * TILE * cell + centre
            at = np.stack(np.meshgrid(x, y), axis=-1)
            distance, row = tree.query(at, distance_upper_bound=reach)
            if np.isfinite(distance).any():
                tiles[layer, corners_y[k], corners_x[k]] = len(pool)
                row = rows[np.asarray(row).clip(max=len(rows) - 1)]
                first.append(int(row[np.isfinite(distance)].min()))
                row = np.where(np.isfinite(distance), row - first[-1], kernels.NONE)
                pool.append(row.astype(np.uint16))
    numbers = np.array(pool, dtype=np.uint16).reshape(-1, TILE, TILE)
    return tiles, np.array(first, dtype=np.int32), numbers
