"""The wall point nearest to each cell of a grid, compiled.

Along a column of cells, the squared distance to a point is a parabola over y. Their lower envelope
(Felzenszwalb and Huttenlocher, Theory of Computing 8, 2012, there for points on the grid) tells the
nearest point of each cell at the cost of a few steps a point and column, where trying all cells
within reach takes hundreds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amr_slam.compiled import jit
from amr_slam.geometry import Array
from amr_slam.registration.kernels import NONE, TILE, Index, Layout, Pool

Rows = NDArray[np.int64]


@jit
def nearest_points(
    points: Array,
    normals: Array,
    layout: Layout,
    shape: tuple[int, int],
    reach: float,
    within: float,
) -> tuple[Index, Index, Pool]:
    """Tiles (5, ty, tx), first rows (k,) and pool (k, TILE, TILE) of :class:`lookup.Lookup`: the
    row of the point nearest to each cell's centre, if it is nearer than ``reach``."""
    ty, tx = shape
    member = np.ones((len(points), 5), dtype=np.bool_)
    for k in range(len(points)):
        member[k, 1] = normals[k, 0] >= within
        member[k, 2] = normals[k, 1] >= within
        member[k, 3] = -normals[k, 0] >= within
        member[k, 4] = -normals[k, 1] >= within
    span = math.ceil(reach / layout[2])
    tiles, count = _tiles(points, member, layout, shape, span)
    rows = np.full((count, TILE, TILE), -1, dtype=np.int32)
    order = np.argsort(points[:, 1], kind="mergesort")
    bottoms = _bottoms(points, layout, tx * TILE, span)
    for layer in range(5):
        members = order[member[order, layer]]
        tops, stack, since = _envelopes(points, members, layout, bottoms, reach)
        for ix in range(tx * TILE):
            x = layout[0] + (ix + 0.5) * layout[2]
            for at in range(bottoms[ix], tops[ix]):
                k = stack[at]
                half = math.sqrt(reach * reach - (x - points[k, 0]) ** 2)
                low = max(points[k, 1] - half, since[at])
                high = points[k, 1] + half
                if at + 1 < tops[ix]:
                    high = min(high, since[at + 1])
                first = max(math.ceil((low - layout[1]) / layout[2] - 0.5), 0)
                end = min(math.ceil((high - layout[1]) / layout[2] - 0.5), ty * TILE)
                for iy in range(first, end):
                    rows[tiles[layer, iy // TILE, ix // TILE], iy % TILE, ix % TILE] = k
    return tiles, *_packed(rows)


@jit
def _tiles(
    points: Array, member: NDArray[np.bool_], layout: Layout, shape: tuple[int, int], span: int
) -> tuple[Index, int]:
    """A number for each tile (5, ty, tx) that a point of the layer may reach, -1 elsewhere; and
    how many there are."""
    x0, y0, cell = layout
    ty, tx = shape
    tiles = np.full((5, ty, tx), -1, dtype=np.int32)
    count = 0
    for k in range(len(points)):
        cx = math.floor((points[k, 0] - x0) / cell)
        cy = math.floor((points[k, 1] - y0) / cell)
        for layer in np.flatnonzero(member[k]):
            for jy in range(max(cy - span, 0) // TILE, min((cy + span) // TILE + 1, ty)):
                for jx in range(max(cx - span, 0) // TILE, min((cx + span) // TILE + 1, tx)):
                    if tiles[layer, jy, jx] < 0:
                        tiles[layer, jy, jx] = count
                        count += 1
    return tiles, count


@jit
def _bottoms(points: Array, layout: Layout, columns: int, span: int) -> Rows:
    """(columns + 1,) where each column's envelope may begin in an array of all of them."""
    bottoms = np.zeros(columns + 1, dtype=np.int64)
    for k in range(len(points)):
        cx = math.floor((points[k, 0] - layout[0]) / layout[2])
        for ix in range(max(cx - span, 0), min(cx + span + 1, columns)):
            bottoms[ix + 1] += 1
    return np.cumsum(bottoms)


@jit
def _envelopes(
    points: Array, members: Rows, layout: Layout, bottoms: Rows, reach: float
) -> tuple[Rows, Index, Array]:
    """(tops, rows, since) of each column's lower envelope, from its bottom to its top: the points
    that are nearest somewhere on it, and from which y on each of them is. ``members``: rows of
    points in the order of their y."""
    x0, _, cell = layout
    span = math.ceil(reach / cell)
    tops = bottoms[:-1].copy()
    stack = np.empty(bottoms[-1], dtype=np.int32)
    since = np.empty(bottoms[-1])
    for k in members:
        px, py = points[k]
        cx = math.floor((px - x0) / cell)
        for ix in range(max(cx - span, 0), min(cx + span + 1, len(tops))):
            x = x0 + (ix + 0.5) * cell
            height = (x - px) ** 2
            if height >= reach * reach:
                continue
            top, begins = tops[ix], -math.inf
            while top > bottoms[ix]:
                ox, oy = points[stack[top - 1]]
                lower = (x - ox) ** 2
                if py > oy:
                    begins = 0.5 * (py + oy) + 0.5 * (height - lower) / (py - oy)
                else:
                    begins = -math.inf if height < lower else math.inf
                if begins > since[top - 1]:
                    break
                top, begins = top - 1, -math.inf
            if begins < math.inf:
                stack[top], since[top] = k, begins
                top += 1
            tops[ix] = top
    return tops, stack, since


@jit
def _packed(rows: Index) -> tuple[Index, Pool]:
    """Least row (k,) of each tile, and its rows (k, TILE, TILE) less that, NONE where none is."""
    first = np.full(len(rows), -1, dtype=np.int32)
    pool = np.full(rows.shape, NONE, dtype=np.uint16)
    for tile in range(len(rows)):
        known = rows[tile].ravel()
        for k in known:
            if k >= 0 and (first[tile] < 0 or k < first[tile]):
                first[tile] = k
        for at in range(len(known)):
            if known[at] >= 0:
                pool[tile, at // TILE, at % TILE] = known[at] - first[tile]
    return first, pool
