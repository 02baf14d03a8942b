"""Exhaustive search in a likelihood field: where RDNM's candidates miss.

A section's range jumps at doorways and in clutter, and with it the signature; the sum over single
points of how near each lies to a wall does not. So every place and heading is tried: with few
points first, the most promising tenth with more. (S. Thrun, W. Burgard, D. Fox, "Probabilistic
Robotics", 2005, section 6.4, for the field.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array
from amr_slam.registration import kernels
from amr_slam.registration.alignment import Target

# What a point costs that stands in free space: people do, so it must not cost much.
_FREE: Final = -30


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldParams:
    """How finely is searched, and with how much of the scan."""

    spacing_m: Annotated[float, Gt(0.0)] = 0.4
    """Distance of neighbouring places."""
    headings: Annotated[int, Ge(4), Le(720)] = 90
    """Headings tried at each place: every 4 degrees."""
    reach_m: Annotated[float, Gt(0.0), Le(1.0)] = 0.6
    """A point this far from a wall counts nothing."""
    cell_m: Annotated[float, Gt(0.0)] = 0.2
    """Side of the field's cells."""
    first_points: Annotated[int, Ge(4)] = 28
    """Points of the scan that are tried everywhere."""
    points: Annotated[int, Ge(4)] = 90
    """Points with which the promising tenth is tried again."""
    candidates: Annotated[int, Ge(0), Le(500)] = 40
    """Poses that are handed on; 0 leaves this search out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """How near the walls are."""

    x0_m: float
    y0_m: float
    cell_m: float
    values: NDArray[np.int8]
    """(ny, nx) in hundredths: 100 on a wall, 0 at reach or beyond, and below 0 where the map saw
    free space and no wall is near."""


def build(target: Target, params: FieldParams) -> Field:
    """The field of a target that has points."""
    grid = target.lookup
    step = max(2, 2 * round(0.5 * params.cell_m / grid.cell_m))
    ny, nx = (size * 2 // step for size in grid.free.shape)
    cell_m = step * grid.cell_m
    x = grid.x0_m + (np.arange(nx) + 0.5) * cell_m
    y = grid.y0_m + (np.arange(ny) + 0.5) * cell_m
    centres = np.stack(np.meshgrid(x, y), axis=-1)
    row = grid.rows(centres, np.zeros_like(centres))
    off = target.points_m[row] - centres
    value = np.clip(1.0 - np.hypot(off[..., 0], off[..., 1]) / params.reach_m, 0.0, 1.0)
    values = np.round(np.where(row >= 0, 100.0 * value, 0.0)).astype(np.int8)
    values[grid.seen_free(centres) & (values == 0)] = _FREE
    return Field(x0_m=grid.x0_m, y0_m=grid.y0_m, cell_m=cell_m, values=values)


def search(source: Cloud, field: Field, places_m: Array, params: FieldParams) -> Array:
    """The best rough poses (k, 4), k <= ``candidates``: x m, y m, theta rad, mean fit; best
    first. ``places_m`` (m, 2). The source holds at least one point."""
    if not len(places_m):
        return np.empty((0, 4))
    column = np.floor((places_m[:, 0] - field.x0_m) / field.cell_m).astype(np.int32)
    row = np.floor((places_m[:, 1] - field.y0_m) / field.cell_m).astype(np.int32)
    place = np.repeat(np.arange(len(places_m), dtype=np.int32), params.headings)
    heading = np.tile(np.arange(params.headings, dtype=np.int32), len(places_m))
    for count, share in ((params.first_points, 0.1), (params.points, 0.0)):
        total = _mean(source, field, params, count, row[place], column[place], heading)
        keep = max(round(share * len(total)), params.candidates)
        best = _largest(total, keep)
        place, heading, total = place[best], heading[best], total[best]
    theta = heading * (math.tau / params.headings)
    return np.column_stack([places_m[place], theta, total])


def _largest(values: NDArray[np.float32], most: int) -> NDArray[np.intp]:
    """Rows of the ``most`` largest values, largest first, equal ones in their order."""
    if len(values) > most:
        bar = np.partition(values, len(values) - most)[len(values) - most]
        rows = np.flatnonzero(values >= bar)
    else:
        rows = np.arange(len(values))
    return rows[np.argsort(-values[rows], kind="stable")][:most]


def _mean(
    source: Cloud,
    field: Field,
    params: FieldParams,
    count: int,
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    headings: NDArray[np.int32],
) -> NDArray[np.float32]:
    chosen = source.even(count)
    theta = np.arange(params.headings)[:, None] * (math.tau / params.headings)
    c, s = np.cos(theta), np.sin(theta)
    px, py = source.points_m[chosen].T
    offsets = np.stack([s * px + c * py, c * px - s * py], axis=2) / field.cell_m
    cells = np.round(offsets).astype(np.int32)
    sum_field = kernels.sum_field if ENABLED else _sum_in_numpy
    total = sum_field(cells, field.values, rows, columns, headings)
    return total / np.float32(len(chosen))


def _sum_in_numpy(
    cells: NDArray[np.int32],
    values: NDArray[np.int8],
    rows: NDArray[np.int32],
    columns: NDArray[np.int32],
    headings: NDArray[np.int32],
) -> NDArray[np.float32]:
    """What :func:`kernels.sum_field` does, a point at a time."""
    out = np.zeros(len(rows), dtype=np.int32)
    for i in range(cells.shape[1]):
        iy, ix = rows + cells[headings, i, 0], columns + cells[headings, i, 1]
        inside = (iy >= 0) & (ix >= 0) & (iy < values.shape[0]) & (ix < values.shape[1])
        out += np.where(inside, values[np.where(inside, iy, 0), np.where(inside, ix, 0)], 0)
    return np.float32(0.01) * out.astype(np.float32)
