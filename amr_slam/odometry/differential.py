"""Two driven wheels on one axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.geometry import Pose2
from amr_slam.odometry.protocol import along_the_step, elapsed_s, gap, is_possible
from amr_slam.samples import DriveSample, Motion, WheelSample


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentialDrive:
    """Two driven wheels on one axis: counts to motion (:class:`Odometry`)."""

    joints: ClassVar[tuple[str, ...]] = ("left", "right")

    radius_left_m: Annotated[float, Gt(0)]
    """Rolling radius of the left wheel in m; from calibration, as tyres differ by per cents."""
    radius_right_m: Annotated[float, Gt(0)]
    """Rolling radius of the right wheel in m."""
    track_m: Annotated[float, Gt(0)]
    """Distance of the two contact points in m; from calibration: the effective one is wider."""
    wheel_m2_per_m: Annotated[float, Ge(0)] = 1e-4
    """Variance of each wheel's travel in m2 per m: 1 % of a metre after a metre."""
    yaw_rad2_per_m: Annotated[float, Ge(0)] = 1e-4
    """Further variance of the heading in rad2 per m of wheel travel, as scrubbing tyres make it."""
    max_speed_mps: Annotated[float, Gt(0)] = 2.0
    """What the drive can do at most in m/s; faster is an encoder fault. Bounds gaps too."""
    max_turn_radps: Annotated[float, Gt(0)] = 3.0
    """What the drive can turn at most in rad/s."""
    stamp_jitter_s: Annotated[float, Ge(0)] = 0.02
    """How late in s a stamp may be: two frames read in one burst are no fast robot."""

    def motion(self, previous: DriveSample, current: DriveSample) -> Motion:
        """See :meth:`Odometry.motion`; the arc of a constant twist, noise of both wheels."""
        if not (isinstance(previous, WheelSample) and isinstance(current, WheelSample)):
            raise TypeError("a differential drive needs wheel samples, not integrated poses")
        left_m = self.radius_left_m * (current.left_rad - previous.left_rad)
        right_m = self.radius_right_m * (current.right_rad - previous.right_rad)
        turn_rad = (right_m - left_m) / self.track_m
        travel_m = 0.5 * (abs(left_m) + abs(right_m))
        dt_s = elapsed_s(previous, current) + self.stamp_jitter_s
        if previous.segment != current.segment or not is_possible(
            max(abs(left_m), abs(right_m)),
            turn_rad,
            dt_s,
            # A turn on the spot moves a wheel faster than the robot.
            self.max_speed_mps + 0.5 * self.track_m * self.max_turn_radps,
            self.max_turn_radps,
        ):
            return self.silence(previous.stamp_ns, current.stamp_ns)
        var_left, var_right = self.wheel_m2_per_m * abs(left_m), self.wheel_m2_per_m * abs(right_m)
        forward = 0.25 * (var_left + var_right)
        cross = 0.5 * (var_right - var_left) / self.track_m
        turn = (var_left + var_right) / self.track_m**2 + self.yaw_rad2_per_m * travel_m
        noise = np.array([[forward, 0.0, cross], [0.0, 0.0, 0.0], [cross, 0.0, turn]])
        twist = np.array([0.5 * (left_m + right_m), 0.0, turn_rad])
        return Motion(
            start_ns=previous.stamp_ns,
            end_ns=current.stamp_ns,
            delta=Pose2.exp(twist),
            covariance=along_the_step(twist, noise),
        )

    def silence(self, start_ns: int, end_ns: int) -> Motion:
        """See :meth:`Odometry.silence`."""
        dt_s = 1e-9 * (end_ns - start_ns) + self.stamp_jitter_s
        return gap(start_ns, end_ns, self.max_speed_mps * dt_s, self.max_turn_radps * dt_s)
