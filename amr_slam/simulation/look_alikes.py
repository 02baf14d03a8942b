"""Seeded worlds that look alike from more than one place."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation.buildings import alike_rooms
from amr_slam.simulation.halls import stepped_outline
from amr_slam.simulation.shapes import box, pillar
from amr_slam.simulation.site import Site
from amr_slam.simulation.world import World

_AISLE_M = 1.3
_ATTEMPTS = 60


def symmetric(seed: int, area_m2: float, *, odd_things: int = 0) -> World:
    """Even seeds: a hall that is the same after a half turn. Odd seeds: a building of rooms of
    which one looks like the next.

    ``odd_things``: so many things have no counterpart; with none the half turn is exact.
    """
    if seed % 2:
        return alike_rooms(seed, area_m2, odd_things=odd_things)
    rng = np.random.default_rng((seed, 6))
    site = Site(stepped_outline(rng, area_m2, half_turn=True))
    kinds = rng.choice(3, max(2, round(area_m2 / 45.0 * rng.uniform(0.6, 1.2))))
    for kind in kinds:
        if kind == 0:
            _put_pair(site, rng, box(*rng.uniform([1.2, 0.8], [2.6, 1.5])), is_table=False)
        elif kind == 1:
            _put_pair(site, rng, box(*rng.uniform([1.2, 0.7], [2.0, 0.9])), is_table=True)
        else:
            _put_pair(site, rng, pillar(rng), is_table=False)
    for _ in range(odd_things):
        site.scatter(rng, box(*rng.uniform(0.3, 0.8, 2)), 1.0)
    return site.world(seed)


def _put_pair(site: Site, rng: np.random.Generator, shape: Array, *, is_table: bool) -> None:
    low, high = site.outline_m.min(axis=0), site.outline_m.max(axis=0)
    apart = 2.0 * float(np.hypot(*shape.T).max()) + _AISLE_M
    for _ in range(_ATTEMPTS):
        turn = rng.integers(2) * 0.5 * math.pi + rng.normal(0.0, 0.1)
        place = rng.uniform(low, high)
        one = Pose2.from_array((*place, turn)) @ shape
        other = low + high - one
        if math.hypot(*(2.0 * place - low - high)) < apart:
            continue
        if site.has_room(one, _AISLE_M) and site.has_room(other, _AISLE_M):
            site.put(one, is_table=is_table)
            site.put(other, is_table=is_table)
            return
