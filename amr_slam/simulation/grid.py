"""The clearance of a world on a grid, for planning and for people who choose their way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from amr_slam.geometry import Array, readonly
from amr_slam.simulation.world import World

_CELL_M = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClearanceGrid:
    """Clearance at the centres of square cells."""

    origin_m: Array
    """(2,) read-only: centre of cell (row 0, column 0)."""
    clearance_m: Array
    """(rows along y, columns along x) read-only; see :meth:`World.clearance`."""
    cell_m: float = _CELL_M

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_m", readonly(self.origin_m))
        object.__setattr__(self, "clearance_m", readonly(self.clearance_m))

    @staticmethod
    def of(world: World) -> ClearanceGrid:
        low, high = world.outline_m.min(axis=0), world.outline_m.max(axis=0)
        columns, rows = (int(n) for n in np.ceil((high - low) / _CELL_M) + 1)
        x = low[0] + _CELL_M * np.arange(columns)
        y = low[1] + _CELL_M * np.arange(rows)
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return ClearanceGrid(
            origin_m=low, clearance_m=world.clearance(points).reshape(rows, columns)
        )

    def at(self, points_m: Array) -> Array:
        """(n,) clearance of the cell that holds each of (n, 2) points; -inf outside."""
        column, row = np.rint((points_m - self.origin_m) / self.cell_m).astype(np.int64).T
        rows, columns = self.clearance_m.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        values = self.clearance_m[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return np.where(inside, values, -np.inf)

    def centre(self, index: int) -> Array:
        """(2,) centre in m of a cell by its flat index, row by row."""
        row, column = divmod(index, self.clearance_m.shape[1])
        return np.array(self.origin_m + self.cell_m * np.array([column, row]))
