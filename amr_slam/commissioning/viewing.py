"""What a robot's scanners would see at a pose, were the map the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.geometry import Array, Pose2
from amr_slam.mounting import Mounting
from amr_slam.registration.alignment import Target
from amr_slam.registration.casting import ranges
from amr_slam.samples import Scan
from amr_slam.simulation import ScannerModel

# A scanner that sees this much of a turn or more makes the heading of a robot irrelevant.
_ALL_AROUND_DEG = 350


@dataclass(frozen=True, slots=True, kw_only=True)
class Eye:
    """One scanner: what it can see and measure, and where it sits."""

    model: ScannerModel
    mounting: Mounting

    @staticmethod
    def of(model: ScannerModel) -> Eye:
        """As the model is mounted, upright and without masks."""
        return Eye(model=model, mounting=Mounting(base_from_lidar=model.base_from_lidar))

    @property
    def bearings_rad(self) -> Array:
        """(beams,) directions in the lidar frame, seen from above."""
        angles = self.model.angles_rad
        return -angles if self.mounting.upside_down else angles

    def rays(self, map_from_base: Pose2) -> tuple[Array, Array]:
        """Origins and unit directions (beams, 2) of its beams in the map frame."""
        pose = map_from_base @ self.mounting.base_from_lidar
        turned = pose.theta_rad + self.bearings_rad
        directions = np.column_stack([np.cos(turned), np.sin(turned)])
        return np.broadcast_to(pose.translation, directions.shape).copy(), directions


def seen(
    target: Target,
    eyes: Sequence[Eye],
    map_from_base: Pose2,
    rng: np.random.Generator,
    params: CloudParams,
) -> Cloud:
    """The cloud that the robot would make of one scan of each of its scanners, with their noise.

    Where the map knows no wall, nothing returns: the real scanner sees more there.
    """
    clouds = []
    for eye in eyes:
        origins, directions = eye.rays(map_from_base)
        model = eye.model
        measured = ranges(target, origins, directions, model.range_max_m)
        measured = measured + rng.normal(0.0, model.sigma_range_m, model.beams)
        if model.quantum_m > 0.0:
            measured = np.round(measured / model.quantum_m) * model.quantum_m
        scan = Scan(
            scanner=model.name,
            stamp_ns=0,
            ranges_m=np.where(measured > 0.0, measured, np.nan),
            angle_min_rad=model.angle_min_rad,
            angle_step_rad=model.angle_step_rad,
            range_max_m=model.range_max_m,
        )
        mounting = eye.mounting
        cloud = cloud_from_scan(
            mounting.masked(scan),
            mounting.base_from_lidar,
            params,
            upside_down=mounting.upside_down,
        )
        clouds.append((cloud, Pose2.identity()))
    return merge(clouds)


def all_around(eyes: Sequence[Eye]) -> bool:
    """Whether the robot sees as much whatever way it heads."""
    covered = np.zeros(360, dtype=np.bool_)
    for eye in eyes:
        bearings = np.degrees(eye.mounting.base_from_lidar.theta_rad + eye.bearings_rad)
        covered[np.floor(bearings).astype(np.int64) % 360] = True
    return int(covered.sum()) >= _ALL_AROUND_DEG
