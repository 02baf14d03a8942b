"""Inner loops of the deconvolved map: compiled where numba is there, else the same in numpy.

Images are (rows, columns) of cells; positions are in cells, (x, y) = (column, row) at a centre.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amr_slam.compiled import ENABLED, jit
from amr_slam.geometry import Array

Image = NDArray[np.float32]
# A climb ends with a step of less than this, in cells.
_ARRIVED = 0.02


def gaussian(sigma_cells: float) -> Image:
    """Taps (2 k + 1,) of a Gaussian cut at three sigma, of sum one."""
    reach = max(math.ceil(3.0 * sigma_cells), 1)
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma_cells) ** 2)
    return np.asarray(taps / taps.sum(), dtype=np.float32)


def blur(image: Image, taps: Image) -> Image:
    """The image convolved with ``taps`` along rows and columns; zero beyond its edges."""
    return _blur_loop(image, taps) if ENABLED else _blur_numpy(image, taps)


def climb(image: Image, starts: Array, bandwidth: float, iterations: int) -> Array:
    """Ridge of a density above ``starts`` (m, 2): rows (m, 5) of x, y, unit vector across the
    ridge, mass under a Gaussian of ``bandwidth`` (0 where there is none).

    Mean shift along the direction of least spread (Ozertem and Erdogmus 2011, locally defined
    principal curves, with the local covariance as Hessian).
    """
    if ENABLED:
        return _climb_loop(image, starts, bandwidth, iterations)
    return _climb_numpy(image, starts, bandwidth, iterations)


@jit
def _add(line: Image, other: Image, factor: np.float32) -> None:
    for column in range(len(line)):
        line[column] += factor * other[column]


@jit
def _blur_loop(image: Image, taps: Image) -> Image:
    rows, columns = image.shape
    reach = len(taps) // 2
    padded = np.zeros(columns + 2 * reach, dtype=np.float32)
    across, result = np.zeros_like(image), np.zeros_like(image)
    for row in range(rows):
        padded[reach : reach + columns] = image[row]
        line = across[row]
        for k in range(len(taps)):
            _add(line, padded[k : k + columns], taps[k])
    for row in range(rows):
        line = result[row]
        for k in range(max(0, reach - row), min(len(taps), rows + reach - row)):
            _add(line, across[row + k - reach], taps[k])
    return result


def _blur_numpy(image: Image, taps: Image) -> Image:
    rows, columns = image.shape
    reach = len(taps) // 2
    across, result = np.zeros_like(image), np.zeros_like(image)
    for k, tap in enumerate(taps):
        shift = k - reach
        first, last = max(0, -shift), min(columns, columns - shift)
        if first < last:
            across[:, first:last] += tap * image[:, first + shift : last + shift]
    for k, tap in enumerate(taps):
        shift = k - reach
        first, last = max(0, -shift), min(rows, rows - shift)
        if first < last:
            result[first:last] += tap * across[first + shift : last + shift]
    return result


@jit
def _climb_loop(image: Image, starts: Array, bandwidth: float, iterations: int) -> Array:
    rows, columns = image.shape
    reach = math.ceil(2.5 * bandwidth)
    width = 2 * reach + 1
    found = np.zeros((len(starts), 5))
    found[:, :2] = starts
    kernel_x, kernel_y = np.empty(width), np.empty(width)
    scale = -0.5 / bandwidth**2
    for i in range(len(starts)):
        for _ in range(iterations):
            x, y = found[i, 0], found[i, 1]
            left, low = math.floor(x + 0.5) - reach, math.floor(y + 0.5) - reach
            for k in range(width):
                kernel_x[k] = math.exp(scale * (left + k - x) ** 2)
                kernel_y[k] = math.exp(scale * (low + k - y) ** 2)
            mass = sx = sy = sxx = sxy = syy = 0.0
            for b in range(max(0, -low), min(width, rows - low)):
                dy = low + b - y
                line = line_x = line_xx = 0.0
                for a in range(max(0, -left), min(width, columns - left)):
                    weight = image[low + b, left + a] * kernel_x[a]
                    dx = left + a - x
                    line += weight
                    line_x += weight * dx
                    line_xx += weight * dx * dx
                mass += kernel_y[b] * line
                sx += kernel_y[b] * line_x
                sy += kernel_y[b] * line * dy
                sxx += kernel_y[b] * line_xx
                sxy += kernel_y[b] * line_x * dy
                syy += kernel_y[b] * line * dy * dy
            if mass <= 0.0:
                break
            sx, sy = sx / mass, sy / mass
            sxx, sxy, syy = sxx / mass - sx * sx, sxy / mass - sx * sy, syy / mass - sy * sy
            ridge = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
            nx, ny = -math.sin(ridge), math.cos(ridge)
            step = sx * nx + sy * ny
            found[i, 0] += step * nx
            found[i, 1] += step * ny
            found[i, 2], found[i, 3], found[i, 4] = nx, ny, mass
            if abs(step) < _ARRIVED:
                break
    return found


def _climb_numpy(image: Image, starts: Array, bandwidth: float, iterations: int) -> Array:
    rows, columns = image.shape
    window = np.arange(-math.ceil(2.5 * bandwidth), math.ceil(2.5 * bandwidth) + 1)
    found = np.zeros((len(starts), 5))
    found[:, :2] = starts
    live = np.arange(len(starts))
    for _ in range(iterations):
        centre = np.floor(found[live, :2] + 0.5).astype(np.int64)
        column, row = centre[:, :1] + window, centre[:, 1:] + window
        inside = ((row >= 0) & (row < rows))[:, :, None] & ((column >= 0) & (column < columns))[
            :, None, :
        ]
        cells = image[
            np.clip(row, 0, rows - 1)[:, :, None], np.clip(column, 0, columns - 1)[:, None, :]
        ]
        dx, dy = column - found[live, :1], row - found[live, 1:2]
        kernel_x, kernel_y = (np.exp(-0.5 * (d / bandwidth) ** 2) for d in (dx, dy))
        weight = np.where(inside, cells, 0.0) * kernel_y[:, :, None] * kernel_x[:, None, :]
        mass = weight.sum(axis=(1, 2))
        held = mass > 0.0
        live, weight, mass, dx, dy = live[held], weight[held], mass[held], dx[held], dy[held]
        by_x, by_y = weight.sum(axis=1), weight.sum(axis=2)
        sx, sy = np.sum(by_x * dx, axis=1) / mass, np.sum(by_y * dy, axis=1) / mass
        sxx = np.sum(by_x * dx * dx, axis=1) / mass - sx * sx
        syy = np.sum(by_y * dy * dy, axis=1) / mass - sy * sy
        sxy = np.einsum("mba,mb,ma->m", weight, dy, dx) / mass - sx * sy
        ridge = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
        normal = np.stack([-np.sin(ridge), np.cos(ridge)], axis=1)
        step = sx * normal[:, 0] + sy * normal[:, 1]
        found[live, :2] += step[:, None] * normal
        found[live, 2:4], found[live, 4] = normal, mass
        live = live[np.abs(step) >= _ARRIVED]
    return found
