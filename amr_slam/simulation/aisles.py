"""Seeded warehouses: long rows of racks that look alike, aisles between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation.halls import stepped_outline
from amr_slam.simulation.site import Site
from amr_slam.simulation.world import World

_BAY_M, _DEPTH_M, _AISLE_M, _CROSSING_M = 2.0, 2.2, 3.0, 4.0
_BAYS: Final = 11
_EDGE_M: Final = 7.0
"""Between the walls, which step in by metres, and the first racks."""
_FILLED, _DIFFERENT = 0.75, 0.1
_TURN_RAD: Final = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Warehouse:
    """A hall full of racks, and the lines along which it is driven."""

    world: World
    aisles_m: Array
    """(k,) y of the ways along x, those beside the outer rows included."""
    crossings_m: Array
    """(j,) x of the ways along y."""

    def drive(self, rng: np.random.Generator, count: int, step_m: float) -> list[Pose2]:
        """``count`` poses about ``step_m`` apart: from crossing to crossing, each time the way
        that was driven least, with a turn on the spot in between."""
        driven: dict[frozenset[tuple[int, int]], int] = {}
        here, came = (0, 0), (0, 0)
        poses: list[Pose2] = []
        while len(poses) < count:
            ways = [one for one in self._neighbours(here) if one != came]
            marks = [driven.get(frozenset((here, one)), 0) + rng.uniform() for one in ways]
            to = ways[int(np.argmin(marks))]
            way = frozenset((here, to))
            driven[way] = driven.get(way, 0) + 1
            poses += self._leg(here, to, poses[-1] if poses else None, step_m, rng)
            here, came = to, here
        return poses[:count]

    def _neighbours(self, node: tuple[int, int]) -> list[tuple[int, int]]:
        j, k = node
        around = [(j - 1, k), (j + 1, k), (j, k - 1), (j, k + 1)]
        most_j, most_k = len(self.crossings_m), len(self.aisles_m)
        return [(a, b) for a, b in around if 0 <= a < most_j and 0 <= b < most_k]

    def _leg(
        self,
        start: tuple[int, int],
        end: tuple[int, int],
        last: Pose2 | None,
        step_m: float,
        rng: np.random.Generator,
    ) -> list[Pose2]:
        """Poses after ``start`` up to ``end``, a little beside the line and off its direction."""
        a, b = (np.array([self.crossings_m[j], self.aisles_m[k]]) for j, k in (start, end))
        length = float(np.hypot(*(b - a)))
        heading = math.atan2(b[1] - a[1], b[0] - a[0])
        line = Pose2(float(a[0]), float(a[1]), heading)
        poses = []
        if last is not None:
            turn = (Pose2(0.0, 0.0, -last.theta_rad) @ Pose2(0.0, 0.0, heading)).theta_rad
            poses.append(Pose2(last.x_m, last.y_m, last.theta_rad + 0.5 * turn))
        for along in np.linspace(0.0, length, max(1, round(length / step_m)) + 1)[1:]:
            beside, off = rng.normal(0.0, 0.1), rng.normal(0.0, 0.03)
            poses.append(line @ Pose2(float(along), float(beside), float(off)))
        return poses


def warehouse(seed: int, area_m2: float) -> Warehouse:
    """Rows of racks over all of ``area_m2``. In every block the same bays are filled, but for one
    in ten; all pallets stand a little askew, each in its own way."""
    rng = np.random.default_rng((seed, 40))
    site = Site(stepped_outline(rng, area_m2))
    width, height = np.ptp(site.outline_m, axis=0)
    block, pitch = _BAYS * _BAY_M, _DEPTH_M + _AISLE_M
    blocks = max(1, int((width - 2.0 * _EDGE_M + _CROSSING_M) / (block + _CROSSING_M)))
    rows = max(1, int((height - 2.0 * _EDGE_M + _AISLE_M) / pitch))
    filled = rng.random(_BAYS) < _FILLED
    for row in range(rows):
        for number in range(blocks):
            pallets = filled ^ (rng.random(_BAYS) < _DIFFERENT)
            turns = rng.normal(0.0, _TURN_RAD, _BAYS)
            x = _EDGE_M + number * (block + _CROSSING_M) + 0.5 * block
            pose = Pose2(x, _EDGE_M + row * pitch + 0.5 * _DEPTH_M, 0.0)
            site.put_rack(pose, block, _DEPTH_M, np.where(pallets, turns, np.nan))
    first = _EDGE_M - 0.5 * _AISLE_M
    return Warehouse(
        world=site.world(seed),
        aisles_m=np.array([first + pitch * k for k in range(rows + 1)]),
        crossings_m=np.array(
            [_EDGE_M - 0.5 * _CROSSING_M + (block + _CROSSING_M) * j for j in range(blocks + 1)]
        ),
    )
