"""What one scan says of the map's cells: still so, or changed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.map.grid import Keys, SparseGrid
from amr_slam.registration import fit
from amr_slam.registration.alignment import Target

_STEP_M: Final = 0.04
"""Between the places along a beam that are looked at."""
_THROUGH_M: Final = 0.04
"""A beam that passes a wall point this near has gone through it."""
_STEEP: Final = 0.35
"""Beams flatter than this to a wall (sine) pass along it by a small error of the pose."""
_ON_WALL_M: Final = 0.1
"""An end point this near to a wall, and three times the noise, lies on it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """Cells by their keys in the map's space grid, each once, ascending."""

    walls_passed: Keys
    """Walls of the map that beams went through ..."""
    walls_met: Keys
    """... and that beams ended on."""
    ends: Keys
    """Floor that was seen free, on which beams ended ..."""
    passed: Keys
    """... and all cells through which beams went."""
    rows: NDArray[np.intp]
    """The cloud's points that ended in ``ends``."""


def look(cloud: Cloud, target: Target, space: SparseGrid, pose: Pose2, range_m: float) -> Sight:
    """The scan at its pose (map_from_base) against the map's ``target`` and ``space``."""
    ends, origins = pose @ cloud.points_m, pose @ cloud.origins_m
    beams = ends - origins
    reach = np.hypot(beams[:, 0], beams[:, 1])
    along = beams / np.maximum(reach, 1e-9)[:, None]
    near = reach <= range_m
    distance = fit.distances(target, ends)
    clearance = fit.clearance(cloud)
    rows = np.flatnonzero(near & target.lookup.seen_free(ends) & (distance > clearance))
    met = ends[near & (distance <= _ON_WALL_M + 3.0 * cloud.across_m)]
    # A beam tells nothing of the last piece before its end: that may be noise.
    sampled_m = np.minimum(reach - clearance, range_m)
    steps = np.arange(0.0, max(float(sampled_m.max(initial=0.0)), 0.0), _STEP_M)
    ray, step = np.nonzero(steps[None, :] < sampled_m[:, None])
    places = origins[ray] + steps[step][:, None] * along[ray]
    return Sight(
        walls_passed=_walls_passed(target, space, places, along[ray]),
        walls_met=_cells_of(target, space, met),
        ends=np.unique(space.keys_of(ends[rows])),
        passed=np.unique(space.keys_of(places[::2])),
        rows=rows,
    )


def _walls_passed(target: Target, space: SparseGrid, places: Array, along: Array) -> Keys:
    near = fit.distances(target, places) <= _THROUGH_M
    places, along = places[near], along[near]
    wall = target.lookup.rows(places, np.zeros_like(places))
    known = wall >= 0
    wall, places, along = wall[known], places[known], along[known]
    points, normals = target.points_m[wall], target.normals[wall]
    flat = np.any(normals != 0.0, axis=1) & (np.abs(np.sum(normals * along, axis=1)) < _STEEP)
    off = np.hypot(*(places - points).T)
    return np.unique(space.keys_of(points[(off <= _THROUGH_M) & ~flat]))


def _cells_of(target: Target, space: SparseGrid, met: Array) -> Keys:
    wall = target.lookup.rows(met, np.zeros_like(met))
    return np.unique(space.keys_of(target.points_m[wall[wall >= 0]]))
