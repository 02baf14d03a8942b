"""Seeded rooms of odd shapes: L, T, U, oblique and curved walls, things at any angle."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.geometry import Array, Pose2, rotation_matrix
from amr_slam.simulation.halls import furnish
from amr_slam.simulation.site import Site, scaled
from amr_slam.simulation.world import World

# Curved walls are polygons with sides of about this length.
_CHORD_M = 0.4


def odd(seed: int, area_m2: float) -> World:
    """A room of ``area_m2`` without a rectangle in it."""
    rng = np.random.default_rng((seed, 5))
    corners = scaled(_letter(rng), area_m2)
    # Walls that were parallel are no more.
    centre, size = corners.mean(axis=0), np.ptp(corners, axis=0).max()
    x, y = ((corners - centre) / size).T
    lean = rng.uniform(-0.35, 0.35, 2)
    bent = np.column_stack([x * (1.0 + lean[0] * y), y * (1.0 + lean[1] * x)])
    corners = scaled(bent @ rotation_matrix(rng.uniform(-math.pi, math.pi)).T, area_m2)
    outline = scaled(_softened(corners, rng), area_m2)
    site = Site(outline)
    furnish(site, rng, area_m2, any_angle=True)
    return site.world(seed)


def _letter(rng: np.random.Generator) -> Array:
    """(k, 2) corners of an L, T or U with strokes of uneven width, counter-clockwise."""
    a, b, c = rng.uniform(0.3, 0.42, 3)
    tall = rng.uniform(0.7, 1.1)
    letters = (
        [(0, 0), (1, 0), (1, b * tall), (a, b * tall), (a, tall), (0, tall)],
        [
            (a, 0),
            (a + b, 0),
            (a + b, tall * (1 - c)),
            (1.1, tall * (1 - c)),
            (1.1, tall),
            (0, tall),
            (0, tall * (1 - c)),
            (a, tall * (1 - c)),
        ],
        [
            (0, 0),
            (1.2, 0),
            (1.2, tall),
            (1.2 - a, tall),
            (1.2 - a, c * tall),
            (b, c * tall),
            (b, tall),
            (0, tall),
        ],
    )
    return np.array(letters[int(rng.integers(3))], dtype=np.float64)


def _softened(corners: Array, rng: np.random.Generator) -> Array:
    """Some corners cut off, some rounded; some sides bulge outwards."""
    points: list[Array] = []
    previous, following = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
    for before, here, after in zip(previous, corners, following, strict=True):
        into, out = here - before, after - here
        reach = min(0.35 * min(math.hypot(*into), math.hypot(*out)), rng.uniform(0.8, 6.0))
        first = here - reach * into / math.hypot(*into)
        last = here + reach * out / math.hypot(*out)
        kind = rng.random()
        if kind < 0.3:
            points += [first, last]
        elif kind < 0.65:
            t = np.linspace(0.0, 1.0, max(4, round(1.6 * reach / _CHORD_M)))[:, None]
            points += [*((1 - t) ** 2 * first + 2 * t * (1 - t) * here + t**2 * last)]
        else:
            points.append(here)
            last = here
        if rng.random() < 0.3 and math.hypot(*out) > 4.0:
            points += [*_bulge(last, here + 0.6 * out, rng)[1:]]
    return np.array(points)


def _bulge(start: Array, end: Array, rng: np.random.Generator) -> Array:
    """(k, 2) an arc that leaves the straight side to the outside and comes back to it."""
    side = end - start
    length = math.hypot(*side)
    frame = Pose2.from_array((*start, math.atan2(side[1], side[0])))
    t = np.linspace(0.0, 1.0, max(5, round(length / _CHORD_M)))
    height = min(0.2 * length, rng.uniform(0.5, 2.5))
    return frame @ np.column_stack([t * length, -4.0 * height * t * (1.0 - t)])
