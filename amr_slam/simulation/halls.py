"""Seeded production halls: an odd outline, pillars, racks in rows, machines, tables on legs."""

from __future__ import annotations

import itertools
import math

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation.shapes import box, box_between, pillar
from amr_slam.simulation.site import Site, scaled
from amr_slam.simulation.world import World

# Room to pass between things that stand freely: two robots' widths less a hand.
_AISLE_M = 1.3
_SMALL_AISLE_M = 1.0


def hall(seed: int, area_m2: float) -> World:
    """A production hall of ``area_m2`` within its outline."""
    rng = np.random.default_rng((seed, 1))
    site = Site(stepped_outline(rng, area_m2))
    if area_m2 > 150.0:
        for _ in range(round(area_m2 * rng.uniform(0.0006, 0.0016) + rng.uniform(0.0, 0.8))):
            _racks(site, rng)
        _pillars(site, rng)
    furnish(site, rng, area_m2)
    return site.world(seed)


def furnish(
    site: Site, rng: np.random.Generator, area_m2: float, *, any_angle: bool = False
) -> None:
    """Machines at walls and in the middle, tables, small things: about one for 14 m2."""
    aisle = _AISLE_M if area_m2 > 100.0 else _SMALL_AISLE_M
    for _ in range(round(0.35 * math.sqrt(area_m2) * rng.uniform(0.6, 1.2))):
        site.at_wall(rng, site.outline_m, rng.uniform([0.8, 0.4], [3.0, 1.2]))
    for _ in range(round(area_m2 / 50.0 * rng.uniform(0.5, 1.2))):
        shape = box(*rng.uniform([1.2, 0.8], [2.6, 1.5]))
        site.scatter(rng, shape, aisle, any_angle=any_angle)
    for _ in range(round(area_m2 / 70.0 * rng.uniform(0.5, 1.2))):
        shape = box(*rng.uniform([1.2, 0.7], [2.0, 0.9]))
        site.scatter(rng, shape, aisle, is_table=True, any_angle=any_angle)
    for _ in range(round(area_m2 / 80.0 * rng.uniform(0.5, 1.2))):
        site.scatter(rng, pillar(rng), aisle, any_angle=any_angle)


def stepped_outline(rng: np.random.Generator, area_m2: float, *, half_turn: bool = False) -> Array:
    """(k, 2) a rectangle whose sides step in and out at odd places, counter-clockwise.

    ``half_turn``: the same again when turned by 180 degrees about its middle.
    """
    ratio = rng.uniform(1.0, 2.0)
    width = math.sqrt(area_m2 * ratio)
    height = area_m2 / width
    corners = box_between(0.0, 0.0, width, height)
    points: list[Array] = []
    sides = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    for corner, following in sides[:2] if half_turn else sides:
        along = following - corner
        length = math.hypot(*along)
        along = along / length
        outward = np.array([along[1], -along[0]])
        points.append(corner)
        free = 0.12 * min(width, height)  # the corners' own, so that two sides never meet
        parts = max(1, round(length / rng.uniform(6.0, 14.0)))
        cuts = np.linspace(free, length - free, parts + 1)
        for low, high in itertools.pairwise(cuts):
            begin = low + rng.uniform(0.05, 0.3) * (high - low)
            end = high - rng.uniform(0.05, 0.3) * (high - low)
            if end - begin < 1.2 or rng.random() < 0.25:
                continue
            depth = min(rng.uniform(0.4, 3.0), 0.8 * free, 0.6 * (end - begin))
            depth *= 1.0 if rng.random() < 0.6 else -0.6
            points += [
                corner + begin * along,
                corner + begin * along + depth * outward,
                corner + end * along + depth * outward,
                corner + end * along,
            ]
    if half_turn:
        points += [corners[2] - point for point in points]
    return scaled(np.array(points), area_m2)


def _pillars(site: Site, rng: np.random.Generator) -> None:
    """On a regular grid, all alike, as they carry a roof; a few are missing."""
    size = rng.uniform(0.3, 0.6)
    spacing = rng.uniform([6.0, 6.0], [12.0, 18.0])
    low, high = site.outline_m.min(axis=0), site.outline_m.max(axis=0)
    for x in np.arange(low[0] + 0.5 * spacing[0], high[0], spacing[0]):
        for y in np.arange(low[1] + 0.5 * spacing[1], high[1], spacing[1]):
            column = box(size, size) + np.array([x, y])
            if rng.random() < 0.9 and site.has_room(column, 0.9):
                site.put(column)


def _racks(site: Site, rng: np.random.Generator) -> None:
    """Two to seven parallel rows with aisles between them, where there is room for each."""
    low, high = site.outline_m.min(axis=0), site.outline_m.max(axis=0)
    bays, rows = int(rng.integers(2, 9)), int(rng.integers(2, 8))
    depth, aisle = rng.uniform([0.8, 1.6], [1.2, 3.0])
    length = 2.0 * bays
    for _ in range(20):
        block = Pose2.from_array((*rng.uniform(low, high), rng.integers(2) * 0.5 * math.pi))
        placed = 0
        for row in range(rows):
            pose = block @ Pose2(0.0, row * (depth + aisle), 0.0)
            if site.has_room(pose @ box(length, depth), _AISLE_M):
                turns = rng.normal(0.0, 0.02, bays)
                site.put_rack(pose, length, depth, np.where(rng.random(bays) < 0.7, turns, np.nan))
                placed += 1
        if placed:
            return
