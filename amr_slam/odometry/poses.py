"""Poses that the vehicle integrates itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.geometry import Pose2
from amr_slam.odometry.protocol import along_the_step, elapsed_s, gap, is_possible
from amr_slam.samples import DriveSample, Motion, OdometrySample


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOdometry:
    """Poses that somebody else integrated: differences to motion (:class:`Odometry`).

    The defaults cover the six public logs measured over 2 s each, robots of unknown calibration.
    """

    joints: ClassVar[tuple[str, ...]] = ()

    along_m2_per_m: Annotated[float, Ge(0)] = 4e-3
    """Variance along the travel in m2 per m (6 cm after a metre; measured 0.003 to 0.006)."""
    across_m2_per_m: Annotated[float, Ge(0)] = 2e-3
    """Variance across the travel in m2 per m (measured 0.001 to 0.002)."""
    xy_m2_per_rad: Annotated[float, Ge(0)] = 5e-3
    """Variance of x and of y in m2 per rad of turn: base frame beside the axis, skid steering."""
    yaw_rad2_per_m: Annotated[float, Ge(0)] = 1e-3
    """Variance of the heading in rad2 per m (1.8 degrees after a metre)."""
    yaw_rad2_per_rad: Annotated[float, Ge(0)] = 1e-2
    """Variance of the heading in rad2 per rad of turn (measured 0.002 to 0.03)."""
    max_speed_mps: Annotated[float, Gt(0)] = 2.0
    """What the robot can do at most in m/s; bounds gaps too."""
    max_turn_radps: Annotated[float, Gt(0)] = 3.0
    """What the robot can turn at most in rad/s."""
    stamp_jitter_s: Annotated[float, Ge(0)] = 0.1
    """How late in s a stamp may be: logs bunch samples (intel: 0.22 m within 3 ms)."""

    def motion(self, previous: DriveSample, current: DriveSample) -> Motion:
        """See :meth:`Odometry.motion`; noise by travel and by turn."""
        if not (isinstance(previous, OdometrySample) and isinstance(current, OdometrySample)):
            raise TypeError("integrated poses are needed, not wheel samples")
        delta = _between(previous.odom_from_base, current.odom_from_base)
        travel_m, turn_rad = math.hypot(delta.x_m, delta.y_m), abs(delta.theta_rad)
        dt_s = elapsed_s(previous, current) + self.stamp_jitter_s
        if previous.segment != current.segment or not is_possible(
            travel_m, turn_rad, dt_s, self.max_speed_mps, self.max_turn_radps
        ):
            return self.silence(previous.stamp_ns, current.stamp_ns)
        by_turn = self.xy_m2_per_rad * turn_rad
        noise = np.diag(
            [
                self.along_m2_per_m * travel_m + by_turn,
                self.across_m2_per_m * travel_m + by_turn,
                self.yaw_rad2_per_m * travel_m + self.yaw_rad2_per_rad * turn_rad,
            ]
        )
        return Motion(
            start_ns=previous.stamp_ns,
            end_ns=current.stamp_ns,
            delta=delta,
            covariance=along_the_step(delta.log(), noise),
        )

    def silence(self, start_ns: int, end_ns: int) -> Motion:
        """See :meth:`Odometry.silence`."""
        dt_s = 1e-9 * (end_ns - start_ns) + self.stamp_jitter_s
        return gap(start_ns, end_ns, self.max_speed_mps * dt_s, self.max_turn_radps * dt_s)


def _between(start: Pose2, end: Pose2) -> Pose2:
    """start_from_end. From differences, so that equal poses give exactly nothing anywhere."""
    dx_m, dy_m = end.x_m - start.x_m, end.y_m - start.y_m
    c, s = math.cos(start.theta_rad), math.sin(start.theta_rad)
    return Pose2(c * dx_m + s * dy_m, c * dy_m - s * dx_m, end.theta_rad - start.theta_rad)
