"""Where the robot may stand: evenly chosen places on the seen floor."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from amr_slam.geometry import Array
from amr_slam.map import PointMap
from amr_slam.map.grid import SparseGrid
from amr_slam.params import SlamParams


def reachable(known: PointMap, params: SlamParams) -> Array:
    """Places (n, 2), ``grid_m`` apart, of the largest part of the floor that hangs together: what
    scanners saw through windows and gaps is none of the robot's."""
    places = known.places(params.grid_m, params.robot_radius_m)
    if not len(places):
        return places
    parts = components(places, 1.5 * params.grid_m)
    return np.asarray(places[parts == np.bincount(parts).argmax()])


def components(points: Array, reach_m: float) -> NDArray[np.int32]:
    """(n,) number of the group of each of points (n, 2), n > 0: neighbours within ``reach_m``
    share one."""
    pairs = cKDTree(points).query_pairs(reach_m, output_type="ndarray")
    n = len(points)
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int32)


def thinned(places: Array, most: int, least_m: float) -> tuple[Array, float]:
    """At most ``most`` (1 or more) of places (n, 2) that are ``least_m`` apart, evenly: one a
    square, the nearest to its middle. And the side of a square in m."""
    if len(places) <= most:
        return places, least_m
    spacing_m = least_m * math.sqrt(len(places) / most)
    while True:
        grid = SparseGrid(spacing_m, 1)
        keys = grid.keys_of(places)
        if len(np.unique(keys)) <= most:
            break
        spacing_m *= 1.1
    off = np.hypot(*(places - grid.centres(keys)).T)
    order = np.lexsort((off, keys))
    _, first = np.unique(keys[order], return_index=True)
    return np.asarray(places[order[first]]), spacing_m
