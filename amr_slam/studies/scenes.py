"""Mapped simulated worlds and places to localize at: what the synthetic studies share.

A :class:`Scene` is a world, where it was scanned to map it, and what these scans showed. Its map
is made at the true poses, so its frame is the world's.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from amr_slam.clouds import Cloud, CloudParams, cloud_from_points, cloud_from_scan, merge
from amr_slam.commissioning import usual_eyes
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.samples import Scan
from amr_slam.simulation import (
    COVERED,
    ScannerModel,
    World,
    free_poses,
    laboratory,
    plan_tour,
    take_scan,
)

S300: Final = ScannerModel(sweep_s=0.0)
"""One scanner in the middle of a standing robot: 541 beams over 270 degrees, whole centimetres."""
MAPPING_SCANS: Final = 85
"""As many scans make the map as in the paper's section 3.1."""
ROBOT_RADIUS_M: Final = 0.35
RIGHT_M: Final = 0.25
RIGHT_RAD: Final = math.radians(5.0)

# A beam's end this near to the end of a mapping beam lies on a mapped wall. Mapping beams end up
# to 0.13 m apart on a wall that is met squarely at 15 m.
_MAPPED_M = 0.15
_ROUNDS = 100


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """A world and the poses (world_from_base) at which it was scanned to map it."""

    kind: str
    world: World
    mapping: tuple[Pose2, ...]
    seen: cKDTree
    """Over the true ends of all mapping beams."""

    @staticmethod
    def of(world: World, kind: str, mapping: Sequence[Pose2], model: ScannerModel = S300) -> Scene:
        """``model``: the scanner that maps; its noise plays no part in what is seen."""
        rng = np.random.default_rng(0)
        ends = [_ends(model, world, pose, rng) for pose in mapping]
        return Scene(
            kind=kind, world=world, mapping=tuple(mapping), seen=cKDTree(np.concatenate(ends))
        )

    def coverage(self, pose: Pose2, model: ScannerModel = S300) -> float:
        """Share of the beams from ``pose`` that end on mapped walls (0 where none returns)."""
        ends = _ends(model, self.world, pose, np.random.default_rng(0))
        if not len(ends):
            return 0.0
        distance, _ = self.seen.query(ends, distance_upper_bound=_MAPPED_M)
        return float(np.mean(np.isfinite(distance)))

    def poses(
        self,
        count: int,
        rng: np.random.Generator,
        *,
        covered: bool = True,
        model: ScannerModel = S300,
    ) -> list[Pose2]:
        """Poses where the robot fits, evenly over the floor and all headings; only covered ones,
        or any. Raises ValueError where hardly any pose is covered."""
        found: list[Pose2] = []
        for _ in range(_ROUNDS):
            free = free_poses(self.world, rng, count, ROBOT_RADIUS_M)
            found += [p for p in free if not covered or self.coverage(p, model) > COVERED]
            if len(found) >= count:
                return found[:count]
        raise ValueError(f"{self.kind} {self.world.seed}: hardly any pose is covered")

    def scan(self, model: ScannerModel, pose: Pose2, rng: np.random.Generator) -> Scan:
        """What a robot that stands at ``pose`` measures."""
        return take_scan(model, self.world, pose, rng)

    def cloud(
        self,
        model: ScannerModel,
        pose: Pose2,
        rng: np.random.Generator,
        params: CloudParams | None = None,
    ) -> Cloud:
        """The same as a cloud in the base frame."""
        scan = self.scan(replace(model, sigma_xy_m=0.0), pose, rng)
        return noisy_cloud(scan, model, rng, params or CloudParams())

    def map_at_truth(self, model: ScannerModel, params: SlamParams, seed: int = 0) -> PointMap:
        """The map from the mapping poses as they truly were; scans noisy as ``model`` says."""
        rng = np.random.default_rng((self.world.seed, seed))
        known = PointMap(params.map)
        for pose in self.mapping:
            known.insert(self.cloud(model, pose, rng, params.clouds), pose)
        return known


def noisy_cloud(
    scan: Scan, model: ScannerModel, rng: np.random.Generator, params: CloudParams
) -> Cloud:
    """The paper's section 3.1 to the letter: noise of ``model.sigma_xy_m`` is added to both x and
    y of each point of a scan without it."""
    reach = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, np.nan)[:, None]
    angles = model.angles_rad
    points = reach * np.column_stack([np.cos(angles), np.sin(angles)])
    points = points + rng.normal(0.0, model.sigma_xy_m, points.shape)
    return cloud_from_points(points, model.base_from_lidar, params, step_rad=model.angle_step_rad)


def with_noise(sigma_xy_m: float, model: ScannerModel = S300) -> ScannerModel:
    """The paper's noise: Gaussian in both x and y of each measured point."""
    return replace(model, sigma_xy_m=sigma_xy_m)


@functools.lru_cache(maxsize=32)
def laboratory_scene(seed: int) -> Scene:
    """The paper's setting: a laboratory of 200 m2, about 85 scans along a closed tour."""
    world = laboratory(seed)
    return Scene.of(world, "laboratory", along(plan_tour(world).path_m, MAPPING_SCANS))


def along(path_m: Array, count: int) -> list[Pose2]:
    """``count`` poses evenly along a closed way (n, 2), looking ahead."""
    rows = np.linspace(0, len(path_m), count, endpoint=False).astype(np.int64)
    step = path_m[(rows + 4) % len(path_m)] - path_m[rows]
    return [
        Pose2(float(x), float(y), math.atan2(dy, dx))
        for (x, y), (dx, dy) in zip(path_m[rows], step, strict=True)
    ]


def is_right(found: Pose2, truth: Pose2) -> bool:
    """Within 0.25 m and 5 degrees."""
    error_m, error_rad = pose_error(found, truth)
    return error_m <= RIGHT_M and error_rad <= RIGHT_RAD


def pose_error(found: Pose2, truth: Pose2) -> tuple[float, float]:
    """Distance in m and angle in rad, neither negative."""
    return found.distance_to(truth), abs((truth.inverse() @ found).theta_rad)


def _ends(model: ScannerModel, world: World, pose: Pose2, rng: np.random.Generator) -> Array:
    """(n, 2) where the beams from ``pose`` end, without noise, in the world."""
    exact = replace(model, sigma_xy_m=0.0, sigma_range_m=0.0, quantum_m=0.0)
    scan = take_scan(exact, world, pose, rng)
    hit = np.isfinite(scan.ranges_m)
    ranges, angles = scan.ranges_m[hit], model.angles_rad[hit]
    points: Array = ranges[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    ends: Array = (pose @ model.base_from_lidar) @ points
    return ends


def seen_by_both(world: World, pose: Pose2, rng: np.random.Generator) -> Cloud:
    """What both scanners of a standing robot, mounted as usual, see in one look."""
    clouds = []
    for eye in usual_eyes():
        scan = take_scan(replace(eye.model, sweep_s=0.0), world, pose, rng)
        cloud = cloud_from_scan(scan, eye.mounting.base_from_lidar, CloudParams())
        clouds.append((cloud, Pose2.identity()))
    return merge(clouds)
