"""Walls of noisy scans are bands as thick as the noise: the lines that explain the bands.

The returns of all scans are counted in the map's cells. Their expectation-maximization
deconvolution by the noise (Richardson 1972, Lucy 1974), with a light blur after each step so
that it settles (Silverman and others 1990), gives the density of surface; its ridges are the
walls. The counts are sums, so that a new scan changes only the cells that it sees, and the
density goes on from where it was (an online EM). Why cells and not each ray: ADR 0008.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array
from amr_slam.map.grid import SparseGrid
from amr_slam.map.kernels import Image, blur, climb, gaussian
from amr_slam.map.smoothing import smooth

# Beyond it an estimate tells of clutter, not of a scanner.
_MOST_NOISE_M = 0.5
# Steps to a density that hardly changes any more: from nothing, and after one more scan.
_STEPS, _STEPS_ONLINE = 40, 1
_BLUR_CELLS = 0.5
# Returns a cell that anything might have: lets a wall appear where there was none.
_FLOOR = 1e-3
_LEAST_BANDWIDTH_M = 0.06
_BANDWIDTH = 0.35  # times the noise across the wall
_CLIMBS = 5
# Ridges of less than this share of the median mass are noise ...
_SUPPORT = 0.1
# ... and those with less than this beside them, where the window is wide.
_SUPPORT_BESIDE = 0.3
# Standard deviation of the window that makes walls straight: times the noise across them, less
# (as squares) this much. At 0.1 m of range noise there was nothing to gain by it.
_WINDOW, _WINDOW_LESS_M = 1.3, 0.12
_TILE = 32
# Online, a tile's ridges are found anew when this share of its density has moved.
_MOVED = 0.05
# A tile's ridges may begin this far outside of it, in cells.
_HALO = 6
# 40,000 m2 of bounding box at 5 cm: two images of it take 128 MB.
_MOST_CELLS = 2**24
# Farther than any wall: where a column of cells begins and ends.
_FAR_CELLS = 1e9
# Columns of the wall sums.
_X, _SIGHT, _COUNT = slice(1, 3), slice(5, 7), 7
Cells = NDArray[np.int64]
_Tile = tuple[int, int]
_Box = tuple[int, int, int, int]  # first row, end row, first column, end column


class Deconvolution:
    """The thin walls of one growing map. ``settle`` depends on the wall sums alone; ``follow``
    is for a map that just grew by a scan."""

    def __init__(self, cell_m: float) -> None:
        self.cell_m = cell_m
        self._low = np.zeros(2, dtype=np.int64)  # cell index of the image's first cell
        self._density: Image = np.zeros((0, 0), dtype=np.float32)
        self._thinned: Image = self._density  # the density that each tile's ridges were found in
        self._ridges: dict[_Tile, Array] = {}
        self._straight: dict[_Tile, Array] = {}  # the same made straight, with their support

    def settle(self, walls: SparseGrid, across_m: float) -> Array:
        """Rows (k, 4) of thin points and unit normals, from a flat start to the fixed point."""
        self._density = self._thinned = np.zeros((0, 0), dtype=np.float32)
        self._ridges, self._straight = {}, {}
        across_m = min(across_m, _MOST_NOISE_M)
        self._cover(walls, across_m)
        rows, columns = self._density.shape
        everything = (0, rows, 0, columns)
        self._iterate(walls, across_m, everything, _STEPS)
        return self._thin(walls, across_m, everything, 0.0)

    def follow(self, walls: SparseGrid, across_m: float, low_m: Array, high_m: Array) -> Array:
        """The same after the walls changed between ``low_m`` and ``high_m`` (2,)."""
        across_m = min(across_m, _MOST_NOISE_M)
        self._cover(walls, across_m)
        reach = self._reach(across_m)
        first = np.floor(low_m / self.cell_m).astype(np.int64) - self._low - reach
        end = np.floor(high_m / self.cell_m).astype(np.int64) - self._low + reach + 2
        core = self._inside((int(first[1]), int(end[1]), int(first[0]), int(end[0])))
        self._iterate(walls, across_m, core, _STEPS_ONLINE)
        return self._thin(walls, across_m, core, _MOVED)

    def _inside(self, box: _Box) -> _Box:
        """The part of a box that lies in the image."""
        rows, columns = self._density.shape
        return max(box[0], 0), min(box[1], rows), max(box[2], 0), min(box[3], columns)

    def _reach(self, across_m: float) -> int:
        return math.ceil(3.0 * across_m / self.cell_m) + 1

    def _cover(self, walls: SparseGrid, across_m: float) -> None:
        """Grow the image, by whole tiles, to hold all walls and their margin."""
        low, high = self._extent(walls, across_m)
        if self._density.size:
            low = np.minimum(low, self._low)
            high = np.maximum(high, self._low + np.array(self._density.shape)[::-1])
        size = (int(high[1] - low[1]), int(high[0] - low[0]))
        if size == self._density.shape:
            return
        shift = self._low - low if self._density.size else np.zeros(2, dtype=np.int64)
        place = tuple(
            slice(int(begin), int(begin) + length)
            for begin, length in zip(shift[::-1], self._density.shape, strict=True)
        )
        grown, thinned = np.zeros((2, *size), dtype=np.float32)
        grown[place], thinned[place] = self._density, self._thinned
        self._density, self._thinned, self._low = grown, thinned, low

    def _extent(self, walls: SparseGrid, across_m: float) -> tuple[Cells, Cells]:
        index = np.floor(walls.centres() / self.cell_m).astype(np.int64)
        margin = 2 * self._reach(across_m)
        low = (index.min(axis=0) - margin) // _TILE * _TILE
        high = -(-(index.max(axis=0) + margin + 1) // _TILE) * _TILE
        return low, high

    def fits(self, walls: SparseGrid, across_m: float) -> bool:
        """Whether there are walls, and not so far apart that an image would fill the memory."""
        if not len(walls):
            return False
        low, high = self._extent(walls, across_m)
        return float(high[0] - low[0]) * float(high[1] - low[1]) <= _MOST_CELLS

    def _image(self, walls: SparseGrid, window: _Box) -> Image:
        """The number of returns at the cells' mean points, each shared by the four next cells."""
        top, bottom, left, right = window
        sums = walls.sums[self._cells(walls, window)].astype(np.float64)
        points = sums[:, _X] / sums[:, :1] / self.cell_m - 0.5 - self._low
        points -= np.array([left, top])
        rows, columns = bottom - top, right - left
        inside = np.all((points >= 0.0) & (points < np.array([columns - 1, rows - 1])), axis=1)
        points, values = points[inside], sums[inside, _COUNT]
        corner = np.floor(points).astype(np.int64)
        fx, fy = (points - corner).T
        flat = corner[:, 1] * columns + corner[:, 0]
        place = np.concatenate([flat, flat + 1, flat + columns, flat + columns + 1])
        shares = np.concatenate(
            [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy]
        )
        image = np.bincount(place, weights=np.tile(values, 4) * shares, minlength=rows * columns)
        return image.reshape(rows, columns).astype(np.float32)

    def _cells(self, walls: SparseGrid, window: _Box) -> slice:
        """Rows of the wall cells in these columns of the image: keys are in the order of x."""
        columns = (self._low[0] + np.array(window[2:])).astype(np.float64)
        corners = np.stack([columns + 0.5, [-_FAR_CELLS, _FAR_CELLS]], axis=1) * self.cell_m
        first, end = np.searchsorted(walls.keys, walls.keys_of(corners))
        return slice(int(first), int(end))

    def _iterate(self, walls: SparseGrid, across_m: float, core: _Box, steps: int) -> None:
        """Steps of the deconvolution inside ``core``; what lies around it is read, not changed."""
        halo = 2 * self._reach(across_m) + 1
        window = self._inside((core[0] - halo, core[1] + halo, core[2] - halo, core[3] + halo))
        top, bottom, left, right = window
        counts = self._image(walls, window)
        taps = gaussian(max(across_m / self.cell_m, 0.3))
        light = gaussian(_BLUR_CELLS)
        view = self._density[top:bottom, left:right]
        inner = np.s_[core[0] - top : core[1] - top, core[2] - left : core[3] - left]
        for _ in range(steps):
            density = view + np.float32(_FLOOR)
            expected = blur(density, taps)
            ratio = np.asarray(counts / np.maximum(expected, 1e-6), dtype=np.float32)
            view[inner] = blur(density * blur(ratio, taps), light)[inner]

    def _thin(self, walls: SparseGrid, across_m: float, core: _Box, moved: float) -> Array:
        tiles = self._moved_tiles(core, moved)
        width_m, beside = self._window(across_m)
        if len(tiles):
            self._find_ridges(walls, across_m, tiles)
            self._straighten(tiles, width_m)
        rows = [self._straight[key] for key in sorted(self._straight)]
        ridges = np.concatenate([np.empty((0, 6)), *rows])
        if not len(ridges):
            return ridges[:, :4]
        typical = np.median(ridges[:, 4:], axis=0)
        held = np.all(ridges[:, 4:] > np.array([_SUPPORT, beside]) * typical, axis=1)
        return np.asarray(ridges[held, :4])

    def _window(self, across_m: float) -> tuple[float, float]:
        """Standard deviation of the window that makes walls straight, and the least share of the
        median support in it: both grow from zero with the noise."""
        full_m = _WINDOW * across_m
        square = full_m**2 - _WINDOW_LESS_M**2
        width_m = math.sqrt(max(square, 0.0))
        return width_m, _SUPPORT_BESIDE * width_m / max(full_m, 1e-9)

    def _straighten(self, tiles: NDArray[np.intp], width_m: float) -> None:
        """Make the ridges of these tiles straight, and of those around, which see them."""
        around = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)])
        keys = tiles + self._low[::-1] // _TILE
        dirty = np.unique((keys[:, None] + around).reshape(-1, 2), axis=0)
        read = np.unique((dirty[:, None] + around).reshape(-1, 2), axis=0)
        changed = set(map(tuple, dirty.tolist()))
        for key in changed:
            self._straight.pop(key, None)
        held = [key for key in map(tuple, read.tolist()) if len(self._ridges.get(key, ()))]
        if not held:
            return
        rows = [self._ridges[key] for key in held]
        straight = smooth(np.concatenate(rows), width_m)
        ends = np.cumsum([len(each) for each in rows])
        for key, end, each in zip(held, ends, rows, strict=True):
            if key in changed:
                self._straight[key] = straight[end - len(each) : end]

    def _moved_tiles(self, core: _Box, moved: float) -> NDArray[np.intp]:
        """(k, 2) row and column of the tiles around ``core`` whose ridges must be found anew."""
        top, left = core[0] // _TILE, core[2] // _TILE
        view = np.s_[
            top * _TILE : -(-core[1] // _TILE) * _TILE, left * _TILE : -(-core[3] // _TILE) * _TILE
        ]

        def per_tile(image: Image) -> Array:
            rows, columns = image.shape
            blocks = image.reshape(rows // _TILE, _TILE, columns // _TILE, _TILE)
            return np.asarray(blocks.sum(axis=(1, 3), dtype=np.float64))

        density = self._density[view]
        mass = per_tile(density)
        change = per_tile(np.abs(density - self._thinned[view]))
        tiles = np.argwhere((change > moved * mass) & (mass + change > 1.0))
        return np.asarray(tiles + np.array([top, left]))

    def _find_ridges(self, walls: SparseGrid, across_m: float, tiles: NDArray[np.intp]) -> None:
        density = self._density
        chosen = np.zeros(np.array(density.shape) // _TILE, dtype=np.bool_)
        chosen[tiles[:, 0], tiles[:, 1]] = True
        for row, column in tiles * _TILE:
            tile = np.s_[row : row + _TILE, column : column + _TILE]
            self._thinned[tile] = density[tile]
        low, high = tiles.min(axis=0) * _TILE - _HALO - 1, (tiles.max(axis=0) + 1) * _TILE + _HALO
        box = self._inside((int(low[0]), int(high[0]) + 1, int(low[1]), int(high[1]) + 1))
        corner = np.array([box[0], box[2]])
        starts = np.argwhere(_crests(density[box[0] : box[1], box[2] : box[3]])) + corner
        starts = starts[_around(chosen, starts)]
        bandwidth = max(_LEAST_BANDWIDTH_M, _BANDWIDTH * across_m) / self.cell_m
        found = climb(density, starts[:, ::-1].astype(np.float64), bandwidth, _CLIMBS)
        self._face(walls, across_m, box, found)
        thin = _one_per_cell(found[found[:, 4] > 0.0])
        home = np.floor((thin[:, 1::-1] + 0.5) / _TILE).astype(np.int64)
        metric = thin.copy()
        metric[:, :2] = (thin[:, :2] + 0.5 + self._low) * self.cell_m
        origin = self._low[::-1] // _TILE
        for tile in tiles:
            key = (int(tile[0] + origin[0]), int(tile[1] + origin[1]))
            self._ridges[key] = metric[np.all(home == tile, axis=1)]

    def _face(self, walls: SparseGrid, across_m: float, box: _Box, found: Array) -> None:
        """Turn the normals of ``found`` to where the walls nearby were seen from."""
        # Twice the cell is fine enough for a side, and four times as quick.
        half = SparseGrid(2.0 * self.cell_m, 2)
        margin = self._reach(across_m)
        top, left = (box[0] - margin) // 2, (box[2] - margin) // 2
        rows, columns = (box[1] + margin) // 2 + 1 - top, (box[3] + margin) // 2 + 1 - left
        window = (2 * top, 2 * (top + rows), 2 * left, 2 * (left + columns))
        sums = walls.sums[self._cells(walls, window)].astype(np.float64)
        half.add(half.keys_of(sums[:, _X] / sums[:, :1]), sums[:, _SIGHT])
        # The image begins at a whole tile: its first cell is the first of a pair.
        index = np.floor(half.centres() / half.cell_m).astype(np.int64) - self._low // 2
        index -= np.array([left, top])
        inside = np.all((index >= 0) & (index < [columns, rows]), axis=1)
        taps = gaussian(max(0.5 * across_m / half.cell_m, 0.5))
        place = np.floor((found[:, :2] + 0.5) / 2.0).astype(np.int64) - [left, top]
        column, row = np.clip(place, 0, [columns - 1, rows - 1]).T
        facing = np.zeros(len(found))
        for axis in (0, 1):
            sights = np.zeros((rows, columns), dtype=np.float32)
            sights[index[inside, 1], index[inside, 0]] = half.sums[inside, axis]
            facing += found[:, 2 + axis] * blur(sights, taps)[row, column]
        found[facing < 0.0, 2:4] *= -1.0


def _crests(density: Image) -> NDArray[np.bool_]:
    """Cells that are as high as both neighbours in one direction at least, and not next to
    nothing: from there the ridges are a few cells away."""
    inner = density[1:-1, 1:-1]
    high = np.zeros(inner.shape, dtype=np.bool_)
    rows, columns = density.shape
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        ahead = density[1 + dy : rows - 1 + dy, 1 + dx : columns - 1 + dx]
        behind = density[1 - dy : rows - 1 - dy, 1 - dx : columns - 1 - dx]
        high |= (inner >= ahead) & (inner >= behind)
    some = inner[inner > 10.0 * _FLOOR]
    least = 0.1 * float(np.percentile(some, 80)) if len(some) else 0.0
    result = np.zeros(density.shape, dtype=np.bool_)
    result[1:-1, 1:-1] = high & (inner > max(least, 10.0 * _FLOOR))
    return result


def _around(chosen: NDArray[np.bool_], cells: Cells) -> NDArray[np.bool_]:
    """Which of ``cells`` (n, 2) lie in a chosen tile or no more than the halo beside one."""
    result = np.zeros(len(cells), dtype=np.bool_)
    last = np.array(chosen.shape) - 1
    for row in (-_HALO, _HALO):
        for column in (-_HALO, _HALO):
            tile = np.clip((cells + np.array([row, column])) // _TILE, 0, last)
            result |= chosen[tile[:, 0], tile[:, 1]]
    return result


def _one_per_cell(found: Array) -> Array:
    """Rows of x, y, normal, mass: their weighted means over each cell."""
    grid = SparseGrid(1.0, 6)
    mass = found[:, 4:5]
    grid.add(grid.keys_of(found[:, :2] + 0.5), np.hstack([mass, found[:, :4] * mass, mass * mass]))
    total = np.maximum(grid.sums[:, :1], 1e-12)
    length = np.maximum(np.linalg.norm(grid.sums[:, 3:5], axis=1, keepdims=True), 1e-12)
    return np.hstack(
        [grid.sums[:, 1:3] / total, grid.sums[:, 3:5] / length, grid.sums[:, 5:] / total]
    )
