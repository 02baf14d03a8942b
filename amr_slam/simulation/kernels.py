"""Compiled loops of the ray casting; see :mod:`amr_slam.compiled`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amr_slam.compiled import jit
from amr_slam.geometry import Array

# Cells grow until there are no more than so many for each segment, and never below this size.
_CELLS_PER_SEGMENT = 2.0
_LEAST_CELL_M = 0.5
# A segment is also known to the cells that its box misses by this: hits are rounded.
_SLACK_M = 1e-6


@jit
def to_segments(origins: Array, directions: Array, segments: Array) -> Array:
    """(n,) distance in m along each beam to the first segment, +inf where there is none.

    ``origins``, ``directions``: (n, 2); ``segments``: (s, 4), s > 0. Each beam walks through the
    square cells of a grid from its start and meets the segments that these hold, until what it
    has met is nearer than the next cell. The meeting point is computed as in
    :func:`amr_slam.simulation.casting.to_all_segments`, operation by operation: same bits.
    """
    low, high, cell = _grid(segments)
    columns = int((high[0] - low[0]) / cell) + 1
    rows = int((high[1] - low[1]) / cell) + 1
    begin, held = _held(segments, low, cell, columns, rows)
    nearest = np.empty(len(origins))
    for i in range(len(origins)):
        ox, oy = origins[i]
        dx, dy = directions[i]
        best = np.inf
        enter = _enter(origins[i], directions[i], low, high)
        column, row = -1, -1
        if enter >= 0.0:
            column = min(max(int((ox + enter * dx - low[0]) / cell), 0), columns - 1)
            row = min(max(int((oy + enter * dy - low[1]) / cell), 0), rows - 1)
        while 0 <= column < columns and 0 <= row < rows:
            at = row * columns + column
            here = held[begin[at] : begin[at + 1]]
            best = min(best, _nearest_of(origins[i], directions[i], segments, here))
            # Over the nearer of the cell's two far sides into the next cell.
            to_column = to_row = np.inf
            if dx != 0.0:
                to_column = (low[0] + (column + (dx > 0.0)) * cell - ox) / dx
            if dy != 0.0:
                to_row = (low[1] + (row + (dy > 0.0)) * cell - oy) / dy
            if best <= min(to_column, to_row) - _SLACK_M:
                break
            if to_column <= to_row:
                column += 1 if dx > 0.0 else -1
            else:
                row += 1 if dy > 0.0 else -1
        nearest[i] = best
    return nearest


@jit
def _grid(segments: Array) -> tuple[Array, Array, float]:
    """Lower left and upper right corner in m of a grid about all segments, and its cell's size."""
    low = np.array(
        [
            min(segments[:, 0].min(), segments[:, 2].min()),
            min(segments[:, 1].min(), segments[:, 3].min()),
        ]
    )
    high = np.array(
        [
            max(segments[:, 0].max(), segments[:, 2].max()),
            max(segments[:, 1].max(), segments[:, 3].max()),
        ]
    )
    low -= 1e-3
    high += 1e-3
    width, height = high[0] - low[0], high[1] - low[1]
    cells = _CELLS_PER_SEGMENT * len(segments)
    least = max(_LEAST_CELL_M, max(width, height) / (cells + 64.0))
    return low, high, max(least, math.sqrt(width * height / cells))


@jit
def _held(
    segments: Array, low: Array, cell: float, columns: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cell c, row by row, holds the segments ``held[begin[c] : begin[c + 1]]``."""
    boxes = np.empty((len(segments), 4), dtype=np.int64)
    begin = np.zeros(columns * rows + 1, dtype=np.int64)
    for s in range(len(segments)):
        x1, y1, x2, y2 = segments[s]
        boxes[s, 0] = max(0, int((min(x1, x2) - _SLACK_M - low[0]) / cell))
        boxes[s, 1] = max(0, int((min(y1, y2) - _SLACK_M - low[1]) / cell))
        boxes[s, 2] = min(columns - 1, int((max(x1, x2) + _SLACK_M - low[0]) / cell))
        boxes[s, 3] = min(rows - 1, int((max(y1, y2) + _SLACK_M - low[1]) / cell))
        for row in range(boxes[s, 1], boxes[s, 3] + 1):
            for column in range(boxes[s, 0], boxes[s, 2] + 1):
                begin[row * columns + column + 1] += 1
    for c in range(columns * rows):
        begin[c + 1] += begin[c]
    held = np.empty(begin[-1], dtype=np.int64)
    filled = begin[:-1].copy()
    for s in range(len(segments)):
        for row in range(boxes[s, 1], boxes[s, 3] + 1):
            for column in range(boxes[s, 0], boxes[s, 2] + 1):
                c = row * columns + column
                held[filled[c]] = s
                filled[c] += 1
    return begin, held


@jit
def _enter(origin: Array, direction: Array, low: Array, high: Array) -> float:
    """Distance in m along a beam to the grid, 0 from within, -1 where it misses the grid."""
    enter, leave = 0.0, np.inf
    for axis in range(2):
        if direction[axis] == 0.0:
            if origin[axis] < low[axis] or origin[axis] > high[axis]:
                return -1.0
        else:
            first = (low[axis] - origin[axis]) / direction[axis]
            second = (high[axis] - origin[axis]) / direction[axis]
            enter = max(enter, min(first, second))
            leave = min(leave, max(first, second))
    return enter if enter <= leave else -1.0


@jit
def _nearest_of(
    origin: Array, direction: Array, segments: Array, chosen: NDArray[np.int64]
) -> float:
    """Distance in m along one beam to the nearest of the chosen segments."""
    ox, oy = origin
    dx, dy = direction
    best = np.inf
    for k in range(len(chosen)):
        x1, y1, x2, y2 = segments[chosen[k]]
        edge_x, edge_y = x2 - x1, y2 - y1
        to_x, to_y = x1 - ox, y1 - oy
        scale = 1.0 / (dx * edge_y - dy * edge_x)
        t = (to_x * edge_y - to_y * edge_x) * scale
        u = (to_x * dy - to_y * dx) * scale
        if t >= 0.0 and 0.0 <= u <= 1.0 and t < best:
            best = t
    return best
