"""Ceiling cameras over a simulated drive: a marker on the robot, in a frame of their own."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Interval
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.recording import Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class CeilingCameras:
    """How they see."""

    site_from_map: Pose2 = field(default_factory=lambda: Pose2(12.3, -4.5, math.radians(40.0)))
    """Their frame from that in which the drive is told."""
    base_from_marker: Pose2 = field(default_factory=lambda: Pose2(0.11, -0.05, math.radians(3.0)))
    """12 cm off the base."""
    every: Annotated[int, Gt(0)] = 2
    """Poses of the drive to each of theirs."""
    latency_s: float = 0.08
    """Their stamps are late by this."""
    sigma_m: Annotated[float, Ge(0)] = 0.01
    sigma_rad: Annotated[float, Ge(0)] = math.radians(0.5)
    swapped: Annotated[float, Interval(ge=0, le=1)] = 0.02
    """Share of poses that are of another robot's marker: of one that follows 350 poses behind."""
    scale: Annotated[float, Gt(0)] = 1.0
    """Their metres, in ours."""

    def watch(
        self, drive: Trajectory, rng: np.random.Generator
    ) -> tuple[Trajectory, NDArray[np.bool_]]:
        """What they say of the drive, and which poses (n,) are another robot's."""
        stamps = drive.stamps_ns[:: self.every]
        moved = [
            self.site_from_map @ Pose2.from_array(pose) @ self.base_from_marker
            for pose in drive.poses[:: self.every]
        ]
        poses: Array = np.array([pose.as_array() for pose in moved])
        poses[:, :2] *= self.scale
        poses[:, :2] += rng.normal(0.0, self.sigma_m, (len(poses), 2))
        poses[:, 2] = wrap_angle(poses[:, 2] + rng.normal(0.0, self.sigma_rad, len(poses)))
        wrong = rng.random(len(poses)) < self.swapped
        poses[wrong] = np.roll(poses, 350, axis=0)[wrong]
        late_ns = round(1e9 * self.latency_s)
        return Trajectory(stamps_ns=stamps + late_ns, poses=poses), wrong
