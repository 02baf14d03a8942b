"""A map's own scans, as far as their rays are kept: what it is found by in another map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array
from amr_slam.map import PointMap

Rows = NDArray[np.intp]


def kept_rows(known: PointMap) -> Rows:
    """Rows of the path whose rays are there and show half a metre of surface."""
    return np.array([row for row, rays in enumerate(known.rays) if len(rays) >= 10], dtype=np.intp)


def spread_rows(known: PointMap, most: int) -> Rows:
    """At most ``most`` of these, each as far as can be from those before it: all over the map,
    and two of them look at different walls. Deterministic."""
    rows = kept_rows(known)
    if len(rows) <= most:
        return rows
    places = path_poses(known)[rows, :2]
    chosen = [0]
    away_m = np.hypot(*(places - places[0]).T)
    while len(chosen) < most:
        farthest = int(np.argmax(away_m))
        chosen.append(farthest)
        away_m = np.minimum(away_m, np.hypot(*(places - places[farthest]).T))
    return rows[chosen]


def cloud_of(known: PointMap, row: int) -> Cloud:
    """What the scan saw, in its base frame."""
    return known.rays[row].cloud(known.path[row][0], known.noises_m[row])


def path_poses(known: PointMap) -> Array:
    """(n, 3) map_from_base of all scans."""
    return np.array([pose.as_array() for _, pose in known.path]).reshape(-1, 3)


def shared_scans(known: PointMap, other: PointMap) -> int:
    """Scans of ``other`` that are in ``known``: of one stamp, with the same rays."""
    rows = {stamp_ns: row for row, (stamp_ns, _) in enumerate(known.path)}
    shared = 0
    for (stamp_ns, _), rays in zip(other.path, other.rays, strict=True):
        row = rows.get(stamp_ns)
        if row is not None and len(rays):
            shared += int(np.array_equal(known.rays[row].ends, rays.ends))
    return shared
