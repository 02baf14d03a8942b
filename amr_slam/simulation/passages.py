"""Seeded corridors: long, crossing each other, with doors and niches at irregular places."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation.shapes import box_between
from amr_slam.simulation.site import Site
from amr_slam.simulation.world import World


def corridors(seed: int, area_m2: float) -> World:
    """Corridors with ``area_m2`` of floor between solid blocks (closed rooms)."""
    rng = np.random.default_rng((seed, 4))
    wanted_block = rng.uniform(10.0, 25.0)
    size = 2
    while True:
        columns, rows = size, max(2, size + int(rng.integers(-1, 2)))
        across, along = rng.uniform(1.7, 2.8, columns), rng.uniform(1.7, 2.8, rows)
        widths, heights = rng.uniform(0.5, 1.5, columns - 1), rng.uniform(0.5, 1.5, rows - 1)
        # Where two blocks grow together, the corridor between them ends in a T.
        joined = np.zeros((rows - 1, columns - 1), dtype=np.bool_)
        for column in range(1, columns - 1):
            joined[:, column] = ~joined[:, column - 1] & (rng.random(rows - 1) < 0.35)
        lost = float(np.sum(joined * across[:-1] * heights[:, None]))
        # All blocks are scaled alike: the floor is linear in their size.
        floor = widths.sum() * along.sum() + heights.sum() * across.sum() - lost
        block = (area_m2 - across.sum() * along.sum()) / floor
        if block <= wanted_block:
            break
        size += 1
    lefts = np.cumsum(across[:-1]) + block * np.concatenate([[0.0], np.cumsum(widths)[:-1]])
    lows = np.cumsum(along[:-1]) + block * np.concatenate([[0.0], np.cumsum(heights)[:-1]])
    rights, highs = lefts + block * widths, lows + block * heights
    blocks: list[Array] = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            if joined[row, column]:
                continue
            last = column
            if column + 1 < columns - 1 and joined[row, column + 1]:
                last = column + 1
            blocks.append(box_between(lefts[column], lows[row], rights[last], highs[row]))
    hull = box_between(0.0, 0.0, rights[-1] + across[-1], highs[-1] + along[-1])
    outline = _with_niches(hull, rng, deepest_m=1.5, to_the_right=True)
    walls = [
        _with_niches(
            corners, rng, deepest_m=0.3 * float(np.ptp(corners, axis=0).min()), to_the_right=False
        )
        for corners in blocks
    ]
    site = Site(outline, walls)
    for _ in range(round(area_m2 / 120.0 * rng.uniform(0.3, 1.0))):
        site.at_wall(rng, hull, rng.uniform([0.5, 0.3], [1.2, 0.45]), gap_m=0.95)
    return site.world(seed)


def _with_niches(
    corners: Array, rng: np.random.Generator, *, deepest_m: float, to_the_right: bool
) -> Array:
    """(k, 2) a polygon with closed doors in their reveals, niches and pilasters on its sides.

    ``to_the_right``: niches lie to the right of who walks along the corners.
    """
    points: list[Array] = []
    every_m = rng.uniform(4.0, 12.0)
    for corner, following in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = following - corner
        length = math.hypot(*side)
        frame = Pose2.from_array((*corner, math.atan2(side[1], side[0])))
        points.append(corner)
        margin = min(deepest_m, 1.5) + 0.4
        begin = margin + rng.exponential(every_m)
        while True:
            kind = rng.random()
            width, depth = rng.uniform([0.9, 0.06], [1.1, 0.2])
            if kind < 0.2:
                width, depth = rng.uniform(1.0, 3.0), min(deepest_m, rng.uniform(0.4, 1.5))
            elif kind < 0.3:
                width, depth = rng.uniform(0.3, 0.6), -rng.uniform(0.08, 0.2)
            end = begin + width
            if end > length - margin:
                break
            y = -depth if to_the_right else depth
            points += [*(frame @ np.array([[begin, 0.0], [begin, y], [end, y], [end, 0.0]]))]
            begin = end + 0.3 + rng.exponential(every_m)
    return np.array(points)
