"""Sums over the square cells of an unbounded plane, stored only where something is."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array

Keys = NDArray[np.int64]
_HALF = 1 << 30  # keys stay positive in 64 bits
_MAX_INDEX = _HALF - 2


def _pack(ix: Keys, iy: Keys) -> Keys:
    return ((ix + _HALF) << 32) | (iy + _HALF)


class SparseGrid:
    """Cells of ``cell_m`` with a row of sums each, sorted by key: look-ups are binary searches."""

    def __init__(self, cell_m: float, channels: int, *, counts: bool = False) -> None:
        """``counts``: only whole numbers are summed, for which half the memory will do."""
        self.cell_m = cell_m
        self.keys: Keys = np.empty(0, dtype=np.int64)
        kind = np.float32 if counts else np.float64
        self.sums = cast("Array", np.empty((0, channels), dtype=kind))

    def __len__(self) -> int:
        return len(self.keys)

    def keys_of(self, points_m: Array) -> Keys:
        """Cell keys (n,) of points (n, 2). Raises ValueError beyond 2^30 cells from the origin."""
        index = np.floor(points_m / self.cell_m)
        if len(index) and not np.all(np.abs(index) < _MAX_INDEX):
            raise ValueError(f"point outside the grid of {self.cell_m} m cells")
        index = index.astype(np.int64)
        return _pack(index[:, 0], index[:, 1])

    def centres(self, keys: Keys | None = None) -> Array:
        """Centres (n, 2) in m of the given cells, or of all."""
        keys = self.keys if keys is None else keys
        ix = (keys >> 32) - _HALF
        iy = (keys & 0xFFFFFFFF) - _HALF
        return np.asarray((np.stack([ix, iy], axis=1) + 0.5) * self.cell_m)

    def add(self, keys: Keys, values: Array) -> None:
        """Add ``values`` (n, channels) to the cells ``keys`` (n,), which may repeat."""
        unique, inverse = np.unique(keys, return_inverse=True)
        total = np.stack(
            [np.bincount(inverse, weights=column, minlength=len(unique)) for column in values.T],
            axis=1,
        )
        place = np.searchsorted(self.keys, unique)
        known = np.zeros(len(unique), dtype=np.bool_)
        inside = place < len(self.keys)
        known[inside] = self.keys[place[inside]] == unique[inside]
        self.sums[place[known]] += total[known]
        self.keys = np.insert(self.keys, place[~known], unique[~known])
        self.sums = np.insert(self.sums, place[~known], total[~known], axis=0)

    def find(self, keys: Keys) -> NDArray[np.intp]:
        """Rows (n,) of the given cells; -1 where nothing is stored."""
        if not len(self.keys):
            return np.full(len(keys), -1, dtype=np.intp)
        place = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[place] == keys, place, -1)
