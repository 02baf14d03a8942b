"""Two versions of a map against each other."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.geometry import Array
from amr_slam.living.change import ChangedCells, Kind, MapDiff, things_of
from amr_slam.map import PointMap
from amr_slam.map.lineage import frame_of
from amr_slam.registration import fit
from amr_slam.registration.alignment import Target

_NEAR_M: Final = 0.15
"""Walls nearer to each other than this, and three times the noise, are one."""
_COMMON: Final = 0.5


class OtherFrameError(Exception):
    """Two maps that do not lie on each other."""


def compare_maps(newer: PointMap, older: PointMap, against: str) -> MapDiff:
    """What ``newer`` has, and has not, beside ``older``, where both know the floor.

    Raises OtherFrameError for maps that have neither frame nor walls in common.
    """
    here, there = newer.surfaces(), older.target()
    if not len(here) or not len(there):
        raise OtherFrameError("one of the maps is empty")
    near_m = _NEAR_M + 3.0 * max(newer.across_m, older.across_m)
    common = float(np.mean(fit.distances(here, there.points_m) <= near_m))
    if frame_of(newer) != frame_of(older) and common < _COMMON:
        raise OtherFrameError(
            f"only {common:.0%} of the older map's walls lie on the newer one's: they are in "
            "different frames"
        )
    cells = (
        _cells(newer, "new", _strangers(here, there, near_m)),
        _cells(newer, "gone", _strangers(there, here, near_m)),
    )
    return MapDiff(changes=things_of(cells, newer.space.cell_m), against=against)


def _strangers(walls: Target, other: Target, near_m: float) -> Array:
    """The wall points that the other map has not, on floor that it has seen free."""
    far = fit.distances(other, walls.points_m) > near_m
    return np.asarray(walls.points_m[far & other.lookup.seen_free(walls.points_m)])


def _cells(newer: PointMap, kind: Kind, points: Array) -> ChangedCells:
    centres = newer.space.centres(np.unique(newer.space.keys_of(points)))
    nobody_knows = np.zeros(len(centres), dtype=np.int64)
    return ChangedCells(
        kind=kind,
        centres_m=centres,
        passes=nobody_knows,
        since_ns=nobody_knows,
        seen_ns=nobody_knows,
    )
