"""A room in which a box has moved, its map, and visits that see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from labs import cloud_at, room, world_of

from amr_slam.geometry import Array, Pose2
from amr_slam.living import Watcher, WatchParams
from amr_slam.map import MapParams, PointMap
from amr_slam.simulation import World
from amr_slam.simulation.shapes import box, edges

WAS: Array = box(1.2, 0.8) + np.array([3.0, 4.0])
IS: Array = box(1.0, 1.0) + np.array([7.0, 5.0])
STAYS: Array = box(0.8, 0.8) + np.array([5.0, 2.0])
KNOWN = np.diag([1e-4, 1e-4, 1e-5])
PLACES = (
    Pose2(1.5, 1.5, 0.3), Pose2(2.0, 2.0, 1.0), Pose2(5.0, 6.5, 1.0), Pose2(8.5, 2.0, 2.0),
    Pose2(8.5, 6.5, -1.0), Pose2(1.5, 6.0, 0.0), Pose2(5.0, 4.0, 2.0),
)  # fmt: skip


def hall(*boxes: Array) -> World:
    return world_of(np.concatenate([room(10.0, 8.0).segments_m, *(edges(one) for one in boxes)]))


BEFORE, AFTER = hall(WAS, STAYS), hall(IS, STAYS)


def mapped(world: World = BEFORE) -> PointMap:
    rng = np.random.default_rng(0)
    known = PointMap(MapParams(), "hall")
    for stamp, pose in enumerate(PLACES):
        known.insert(cloud_at(world, pose, rng, sigma_m=0.01, stamp_ns=stamp), pose)
    return known


@dataclass
class Day:
    """Hands visits to a watcher; its clock goes on."""

    watcher: Watcher
    utc_s: float = 1e9
    seed: int = 0

    def visit(self, world: World, *, people: bool = False, away_s: float = 600.0) -> None:
        self.seed += 1
        rng = np.random.default_rng(self.seed)
        for place in PLACES:
            for step in range(2):
                pose = place @ Pose2(0.2 * step, 0.0, 0.0)
                told = pose @ Pose2(*rng.normal(0.0, [0.01, 0.01, 0.003]).tolist())
                walkers = rng.uniform([4.0, 3.0], [9.0, 7.0], (2, 2)) if people else None
                if walkers is not None:
                    walkers = walkers[np.hypot(*(walkers - pose.translation).T) > 0.8]
                cloud = cloud_at(world, pose, rng, sigma_m=0.01, people_m=walkers)
                self.watcher.see(cloud, told, KNOWN, round(1e9 * self.utc_s))
                self.utc_s += 8.0
        self.utc_s += away_s


def watching(known: PointMap) -> Day:
    return Day(Watcher(known, WatchParams()))
