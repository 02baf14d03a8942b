"""How well two point sets lie on each other: e_psr, equation 1 of the paper."""

from __future__ import annotations

import math

import numpy as np
import scipy

from amr_slam.geometry import Array


def e_psr(source_m: Array, target: scipy.spatial.cKDTree, threshold_m: float = 1.0) -> float:
    """Mean distance (m) from each source point (n, 2) to its nearest target point.

    Only distances below ``threshold_m`` (the paper's epsilon, 1 m) count, so that a scan that
    is a subset of the map is judged by what both have. inf where none is near. (Eq. 1.)
    """
    return mean_below(nearest(source_m, target, threshold_m))


def nearest(source_m: Array, target: scipy.spatial.cKDTree, threshold_m: float = 1.0) -> Array:
    """Distances d_min (n,) in m to the nearest target point; inf at ``threshold_m`` or beyond."""
    if not len(source_m) or not target.n:
        return np.full(len(source_m), np.inf)
    return np.asarray(target.query(source_m, distance_upper_bound=threshold_m)[0])


def mean_below(distances_m: Array) -> float:
    """Mean of the finite distances: :func:`e_psr` from what :func:`nearest` returned."""
    near = distances_m[np.isfinite(distances_m)]
    return float(near.mean()) if len(near) else math.inf
