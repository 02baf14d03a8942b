"""Where to map a simulated world, where to localize in it, and what the map can know there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation.planning import STEP_M
from amr_slam.simulation.scanner import ScannerModel, take_scan
from amr_slam.simulation.tour import plan_tour
from amr_slam.simulation.world import World

COVERED: Final = 0.85
"""A pose is covered if more than this share of its beams ends on walls that the mapping saw."""

# A beam's end this near to the end of a mapping beam lies on a mapped wall. Mapping beams end up
# to 0.13 m apart on a wall that is met squarely at 15 m.
_MAPPED_M = 0.15
# Some steps ahead of a place on the tour the robot looks.
_AHEAD = 4
_ROUNDS = 100


def free_poses(
    world: World, rng: np.random.Generator, count: int, clearance_m: float
) -> list[Pose2]:
    """Poses evenly over the floor that is ``clearance_m`` from everything, and over all headings.

    Raises ValueError where there is hardly any such place.
    """
    low, high = world.outline_m.min(axis=0), world.outline_m.max(axis=0)
    found: list[Pose2] = []
    for _ in range(_ROUNDS):
        points = rng.uniform(low, high, (4 * count, 2))
        headings = rng.uniform(-math.pi, math.pi, len(points))
        for row in np.flatnonzero(world.clearance(points) >= clearance_m):
            found.append(Pose2(points[row, 0], points[row, 1], headings[row]))
            if len(found) == count:
                return found
    raise ValueError(f"hardly any place is {clearance_m} m from everything")


def mapping_poses(world: World, spacing_m: float = 0.6) -> tuple[Pose2, ...]:
    """Every ``spacing_m`` (a multiple of 5 cm) of the world's tour, looking ahead along it."""
    path = plan_tour(world).path_m
    ahead = np.roll(path, -_AHEAD, axis=0) - path
    return tuple(
        Pose2(path[i, 0], path[i, 1], math.atan2(ahead[i, 1], ahead[i, 0]))
        for i in range(0, len(path), round(spacing_m / STEP_M))
    )


class Coverage:
    """Which parts of a world's walls the scans at some poses saw."""

    def __init__(self, world: World, mapping: Sequence[Pose2], scanner: ScannerModel) -> None:
        """``mapping``: poses of the base in the world; ``scanner``: as it maps and localizes. Its
        noise plays no part in what is seen."""
        self._world = world
        self._scanner = replace(scanner, sigma_xy_m=0.0, sigma_range_m=0.0, quantum_m=0.0)
        self._seen = cKDTree(np.concatenate([self._ends(pose) for pose in mapping]))

    def share(self, pose: Pose2) -> float:
        """Share of the returning beams from ``pose`` that end on seen walls; 0 if none returns."""
        ends = self._ends(pose)
        if not len(ends):
            return 0.0
        distance, _ = self._seen.query(ends, distance_upper_bound=_MAPPED_M)
        return float(np.mean(np.isfinite(distance)))

    def covers(self, pose: Pose2) -> bool:
        """Whether the map can know what is seen from ``pose``."""
        return self.share(pose) > COVERED

    def _ends(self, pose: Pose2) -> Array:
        """(n, 2) where the beams from ``pose`` end, in the world."""
        scan = take_scan(self._scanner, self._world, pose, np.random.default_rng(0))
        hit = np.isfinite(scan.ranges_m)
        ranges, angles = scan.ranges_m[hit], self._scanner.angles_rad[hit]
        points: Array = ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        return (pose @ self._scanner.base_from_lidar) @ points
