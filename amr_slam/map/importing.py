"""A map of another program's occupancy grid: walls with normals, floor, and how wrong both are.

A cell that is occupied holds the wall somewhere: its surface is taken for its middle, made smooth
along the wall, and never trusted to more than half a cell.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array
from amr_slam.map.described import read_description
from amr_slam.map.file import MapError
from amr_slam.map.grid import Keys, SparseGrid
from amr_slam.map.occupancy import OccupancyGrid, read_grid
from amr_slam.map.params import MapParams
from amr_slam.map.pointmap import PointMap
from amr_slam.map.provenance import Imported
from amr_slam.map.smoothing import smooth

_RESOLUTIONS_M: Final = (0.004, 1.0)
_SIDES: Final = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""Rows up and columns to the right, from a wall to the floor before it."""
_GAP_M: Final = 0.25
"""So much unknown may lie between floor and wall: rays that graze a wall tell of neither."""
_MOST_GAP: Final = 12
_BOTH_SIDES: Final = 1.0 / 6.0
"""Two surfaces anywhere in one cell lie this share of it off its middle, on average."""
_SMOOTH_CELLS: Final = 3.0
_MAX_FACES: Final = 4_000_000
_AT_ONCE: Final = 1_000_000
_MAX_NAME: Final = 200


def import_map(path: Path, name: str) -> PointMap:
    """The map that a map server's YAML file describes. Raises MapError."""
    described = read_description(path)
    low, high = _RESOLUTIONS_M
    if not low <= described.resolution_m <= high:
        raise MapError(
            f"{path}: resolution: {described.resolution_m:g}: cells of {low:g} to {high:g} m can "
            "be localized in"
        )
    grid = read_grid(described)
    for cells, what in ((grid.free, "floor (free cells)"), (grid.occupied, "wall")):
        if not cells.any():
            raise MapError(
                f"{described.image}: shows no {what}: are mode, negate and thresholds right?"
            )
    imported = Imported(
        source=described.image.name[:_MAX_NAME],
        resolution_m=grid.resolution_m,
        error_m=0.5 * grid.resolution_m,
    )
    try:
        known = map_of(grid, imported, name)
        _ = known.target().lookup
    except ValueError as error:
        raise MapError(f"{described.image}: {error}: is it a map?") from error
    return known


def map_of(grid: OccupancyGrid, imported: Imported, name: str) -> PointMap:
    """A map of a grid's cells. Raises ValueError where there are too many walls, or none that
    any floor lies before."""
    params = MapParams()
    # Both surfaces of a thin wall are points of their own.
    params = replace(
        params,
        cell_m=0.25 * grid.resolution_m,
        free_cell_m=max(params.free_cell_m, grid.resolution_m),
    )
    known = PointMap(params, name)
    known.imported = imported
    points, normals = faces(grid)
    known.walls.add(known.walls.keys_of(points), _sums(points, normals))
    _lay_floor(known.space, grid)
    known.revision += 1
    return known


def faces(grid: OccupancyGrid) -> tuple[Array, Array]:
    """Points (n, 2) on the surfaces of walls that floor lies before, and unit normals (n, 2)."""
    sides = [_side(grid, *side) for side in _SIDES]
    if not any(len(row) for row, _, _ in sides):
        raise ValueError("there is no floor before its walls")
    if sum(len(row) for row, _, _ in sides) > _MAX_FACES:
        raise ValueError("too many walls")
    found: list[Array] = []
    for (up, right), (row, column, thin) in zip(_SIDES, sides, strict=True):
        off = np.where(thin, _BOTH_SIDES, 0.0)
        x = column + 0.5 + off * right
        y = row + 0.5 + off * up
        n = len(row)
        ridges = np.column_stack([x, y, np.full(n, right), np.full(n, up), np.ones(n)])
        # Walls that face other ways have no say: a thin one's two sides stay two.
        found.append(smooth(ridges.astype(np.float64), _SMOOTH_CELLS))
    rows = np.concatenate(found)
    corner = grid.map_from_corner
    return (
        corner @ np.asarray(grid.resolution_m * rows[:, :2]),
        np.asarray(rows[:, 2:4] @ corner.rotation.T),
    )


def _side(
    grid: OccupancyGrid, up: int, right: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Rows and columns (n,) of the wall cells that floor lies before in this direction, and which
    of them floor lies behind, too: walls as thin as a cell."""
    ahead = _floor_before(grid, up, right)
    thin = ahead & _floor_before(grid, -up, -right)
    row, column = np.nonzero(ahead)
    return row, column, thin[row, column]


def _floor_before(grid: OccupancyGrid, up: int, right: int) -> NDArray[np.bool_]:
    """Wall cells from which floor is the first that is known in this direction."""
    gap = int(np.clip(round(_GAP_M / grid.resolution_m), 1, _MOST_GAP))
    pending = grid.occupied.copy()
    met = np.zeros_like(pending)
    for step in range(1, gap + 1):
        met |= pending & _shifted(grid.free, step * up, step * right)
        pending &= ~_shifted(grid.free | grid.occupied, step * up, step * right)
    return met


def _shifted(cells: NDArray[np.bool_], up: int, right: int) -> NDArray[np.bool_]:
    """What lies so many cells up and to the right of each cell; nothing beyond the edges."""
    out = np.zeros_like(cells)
    rows, columns = cells.shape
    if abs(up) < rows and abs(right) < columns:
        to = np.s_[max(-up, 0) : rows - max(up, 0), max(-right, 0) : columns - max(right, 0)]
        of = np.s_[max(up, 0) : rows - max(-up, 0), max(right, 0) : columns - max(-right, 0)]
        out[to] = cells[of]
    return out


def _sums(points: Array, normals: Array) -> Array:
    """(n, 8) what a wall cell sums (docs/map-format.md), each surface seen once."""
    double = 2.0 * np.arctan2(normals[:, 1], normals[:, 0])
    one = np.ones(len(points))
    return np.column_stack([one, points, np.cos(double), np.sin(double), normals, one])


def _lay_floor(space: SparseGrid, grid: OccupancyGrid) -> None:
    """Where a wall stands a ray has ended, where there is floor only one has passed."""
    ended, passed = _keys(space, grid, grid.occupied), _keys(space, grid, grid.free)
    passed = np.setdiff1d(passed, ended, assume_unique=True)
    keys = np.concatenate([passed, ended])
    flags = np.zeros((len(keys), 2))
    flags[: len(passed), 0] = 1.0
    flags[len(passed) :, 1] = 1.0
    space.add(keys, flags)


def _keys(space: SparseGrid, grid: OccupancyGrid, cells: NDArray[np.bool_]) -> Keys:
    """Keys of the map's space that these cells of the grid cover, each once."""
    per_side = math.ceil(2.0 * grid.resolution_m / space.cell_m)
    steps = (np.arange(per_side) + 0.5) / per_side
    x, y = (side.ravel() for side in np.meshgrid(steps, steps))
    found: list[Keys] = [np.empty(0, dtype=np.int64)]
    row, column = np.nonzero(cells)
    for part in np.array_split(np.arange(len(row)), 1 + len(row) * len(x) // _AT_ONCE):
        places = np.stack([column[part, None] + x, row[part, None] + y], axis=-1).reshape(-1, 2)
        there = grid.map_from_corner @ np.asarray(grid.resolution_m * places)
        found.append(np.unique(space.keys_of(there)))
    return np.unique(np.concatenate(found))
