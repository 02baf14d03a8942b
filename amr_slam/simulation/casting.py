"""Exact ray casting against straight walls and round people."""

from __future__ import annotations

import numpy as np

from amr_slam import compiled
from amr_slam.geometry import Array
from amr_slam.simulation import kernels


def cast(
    origins_m: Array,
    angles_rad: Array,
    segments_m: Array,
    circle_centres_m: Array | None = None,
    circle_radius_m: float = 0.0,
) -> Array:
    """(n,) distance in m along each beam to what it meets first, +inf where it meets nothing.

    ``origins_m``: (n, 2) start of each beam; ``angles_rad``: (n,) its direction in the same
    frame; ``segments_m``: (s, 4). ``circle_centres_m``: (n, k, 2), where each of k circles is at
    the time of each beam; a circle that holds the beam's start is not met.
    """
    directions = np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    if compiled.ENABLED and len(segments_m):
        distance = kernels.to_segments(
            np.array(origins_m, dtype=np.float64),
            directions,
            np.array(segments_m, dtype=np.float64),  # compiled for one kind only: writable
        )
    else:
        distance = to_all_segments(origins_m, directions, segments_m)
    if circle_centres_m is not None and circle_centres_m.shape[1] > 0:
        circles = _to_circles(origins_m, directions, circle_centres_m, circle_radius_m)
        distance = np.minimum(distance, circles)
    return distance


def to_all_segments(origins: Array, directions: Array, segments: Array) -> Array:
    """(n,) as :func:`amr_slam.simulation.kernels.to_segments`, from each beam and segment.

    Solves origin + t direction = start + u edge.
    """
    edge_x, edge_y = (segments[:, 2:] - segments[:, :2]).T
    to_x = segments[:, 0] - origins[:, :1]
    to_y = segments[:, 1] - origins[:, 1:]
    dx, dy = directions[:, :1], directions[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel: no meeting, tested below
        scale = 1.0 / (dx * edge_y - dy * edge_x)
        t = (to_x * edge_y - to_y * edge_x) * scale
        u = (to_x * dy - to_y * dx) * scale
        meets = (t >= 0.0) & (u >= 0.0) & (u <= 1.0)
    nearest: Array = np.min(np.where(meets, t, np.inf), axis=1, initial=np.inf)
    return nearest


def _to_circles(origins: Array, directions: Array, centres: Array, radius: float) -> Array:
    to_centre = centres - origins[:, None, :]
    along = np.einsum("nkd,nd->nk", to_centre, directions)
    outside = np.sum(to_centre * to_centre, axis=2) - radius * radius
    discriminant = along * along - outside
    meets = (along > 0.0) & (outside > 0.0) & (discriminant >= 0.0)
    near = along - np.sqrt(np.where(meets, discriminant, 0.0))
    nearest: Array = np.min(np.where(meets, near, np.inf), axis=1)
    return nearest
