"""Thin walls of noisy maps, made straight: compiled where numba is there, else by k-d tree.

Each ridge point moves across its wall onto the line through the points beside it (moving least
squares, Levin 2004), the heavier ones first of all; points of other directions and of parallel
walls hardly count, so that corners and boards stay. What a point found beside it tells a wall
from a clump of stray returns.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from amr_slam.compiled import ENABLED, jit
from amr_slam.geometry import Array

# Neighbours farther than this, in widths, count nothing.
_REACH = 2.5
# A line off the point's own by as much as this share of the width counts by 0.6.
_ACROSS = 0.7
# The eighth power of the cosine between normals counts: 0.6 at 20 degrees, 0.06 at 45. Beyond 55
# it is nothing.
_LEAST_SQUARED_COSINE = 0.33
# Spread along and across more alike than this: no line.
_LEAST_ELONGATION = 0.3
_COLUMNS = 6


def smooth(ridges: Array, width_m: float) -> Array:
    """Rows (n, 6) of x, y, unit normal, mass and support of ridge points (n, 5), ``width_m`` the
    standard deviation of the window. Support is the mass beside and in the point; with no width
    nothing moves and it is the point's own mass."""
    if width_m <= 0.0 or not len(ridges):
        return np.hstack([ridges, ridges[:, 4:5]])
    order = np.argsort(ridges[:, 0], kind="stable")
    moments = (_moments_loop if ENABLED else _moments_numpy)(ridges[order], width_m)
    result = np.empty((len(ridges), _COLUMNS))
    result[order] = _moved(ridges[order], moments)
    return result


def _moved(ridges: Array, moments: Array) -> Array:
    """The points on the lines of their neighbours; ``moments`` (n, 6) are the neighbours' mass
    and, around the point, their mean x, y and mean xx, xy, yy."""
    mass, mx, my, mxx, mxy, myy = moments.T
    xx, xy, yy = mxx - mx * mx, mxy - mx * my, myy - my * my
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    normals = np.stack([-np.sin(along), np.cos(along)], axis=1)
    own = ridges[:, 2:4]
    line = np.hypot(xx - yy, 2.0 * xy) >= _LEAST_ELONGATION * np.maximum(xx + yy, 1e-12)
    normals = np.where(line[:, None], normals, own)
    normals[np.sum(normals * own, axis=1) < 0.0] *= -1.0
    step = mx * normals[:, 0] + my * normals[:, 1]
    points = ridges[:, :2] + step[:, None] * normals
    return np.column_stack([points, normals, ridges[:, 4], mass])


@jit
def _moments_loop(ridges: Array, width_m: float) -> Array:
    n = len(ridges)
    result = np.zeros((n, 6))
    reach = _REACH * width_m
    near, far = -0.5 / width_m**2, -0.5 / (_ACROSS * width_m) ** 2
    first = 0
    for i in range(n):
        while ridges[first, 0] < ridges[i, 0] - reach:
            first += 1
        for j in range(first, n):
            dx, dy = ridges[j, 0] - ridges[i, 0], ridges[j, 1] - ridges[i, 1]
            if dx > reach:
                break
            square = dx * dx + dy * dy
            if square > reach * reach:
                continue
            across = ridges[i, 2] * dx + ridges[i, 3] * dy
            agree = (ridges[i, 2] * ridges[j, 2] + ridges[i, 3] * ridges[j, 3]) ** 2
            if agree < _LEAST_SQUARED_COSINE:
                continue
            agree *= agree
            weight = ridges[j, 4] * agree * agree
            weight *= math.exp(near * square + far * across * across)
            result[i, 0] += weight
            result[i, 1] += weight * dx
            result[i, 2] += weight * dy
            result[i, 3] += weight * dx * dx
            result[i, 4] += weight * dx * dy
            result[i, 5] += weight * dy * dy
        for k in range(1, 6):
            result[i, k] /= result[i, 0]
    return result


def _moments_numpy(ridges: Array, width_m: float) -> Array:
    n = len(ridges)
    tree = scipy.spatial.cKDTree(ridges[:, :2])
    pairs = tree.query_pairs(_REACH * width_m, output_type="ndarray")
    i = np.concatenate([pairs[:, 0], pairs[:, 1], np.arange(n)])
    j = np.concatenate([pairs[:, 1], pairs[:, 0], np.arange(n)])
    dx, dy = (ridges[j, :2] - ridges[i, :2]).T
    across = ridges[i, 2] * dx + ridges[i, 3] * dy
    agree = np.sum(ridges[i, 2:4] * ridges[j, 2:4], axis=1) ** 2
    weight = np.where(agree < _LEAST_SQUARED_COSINE, 0.0, ridges[j, 4] * agree**4)
    weight *= np.exp(-0.5 * (dx * dx + dy * dy + (across / _ACROSS) ** 2) / width_m**2)
    columns = [np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy]
    sums = [np.bincount(i, weight * column, minlength=n) for column in columns]
    return np.stack([sums[0], *(column / sums[0] for column in sums[1:])], axis=1)
