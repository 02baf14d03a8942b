"""One steered, driven wheel and a fixed axle: fork-lift trucks and tuggers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Gt, Interval

from amr_slam.geometry import Array, Pose2
from amr_slam.odometry.protocol import along_the_step, elapsed_s, gap, is_possible
from amr_slam.samples import DriveSample, JointSample, Motion


@dataclass(frozen=True, slots=True, kw_only=True)
class TricycleDrive:
    """A steered drive wheel and a fixed axle: counts to motion (:class:`Odometry`).

    The base frame's origin is the middle of the fixed axle, as only there nothing moves sideways.
    Raises ValueError for a steered wheel on the fixed axle.
    """

    joints: ClassVar[tuple[str, ...]] = ("drive", "steer")

    radius_m: Annotated[float, Gt(0)]
    """Rolling radius of the drive wheel in m; from calibration."""
    wheel_base_m: Annotated[float, Interval(ge=-20, le=20)]
    """From the fixed axle ahead to the steered wheel's axle in m; negative: it is behind."""
    wheel_y_m: Annotated[float, Interval(ge=-5, le=5)] = 0.0
    """Left of the middle to the steered wheel in m: on many trucks it sits beside it."""
    steer_offset_rad: Annotated[float, Interval(ge=-math.pi, le=math.pi)] = 0.0
    """What the driver's steering angle is when the robot drives straight ahead; taken off it."""
    wheel_m2_per_m: Annotated[float, Ge(0)] = 1e-4
    """Variance of the wheel's travel in m2 per m: 1 % of a metre after a metre."""
    steer_rad2_m: Annotated[float, Ge(0)] = 4e-5
    """Variance of the steering angle in rad2 times the way in m over which an error of it stays,
    doubled: 0.5 degrees over 0.25 m."""
    yaw_rad2_per_m: Annotated[float, Ge(0)] = 1e-4
    """Further variance of the heading in rad2 per m of wheel travel, as scrubbing tyres make it."""
    max_speed_mps: Annotated[float, Gt(0)] = 2.0
    """What the drive can do at most in m/s; faster is an encoder fault. Bounds gaps too."""
    max_turn_radps: Annotated[float, Gt(0)] = 3.0
    """What the drive can turn at most in rad/s."""
    stamp_jitter_s: Annotated[float, Ge(0)] = 0.02
    """How late in s a stamp may be: two frames read in one burst are no fast robot."""

    def __post_init__(self) -> None:
        if abs(self.wheel_base_m) < 0.05:
            raise ValueError(f"wheel_base_m of {self.wheel_base_m} m: no drive steers like that")

    def motion(self, previous: DriveSample, current: DriveSample) -> Motion:
        """See :meth:`Odometry.motion`.

        The steering turns evenly while the wheel rolls evenly: the turn is then exact; the way is
        the arc of the mean twist.
        """
        (start_rad, from_rad), (end_rad, to_rad) = _angles(previous), _angles(current)
        dt_s = elapsed_s(previous, current) + self.stamp_jitter_s
        if not all(map(math.isfinite, (start_rad, from_rad, end_rad, to_rad))):
            return self.silence(previous.stamp_ns, current.stamp_ns)
        rolled_m = self.radius_m * (end_rad - start_rad)
        half_rad = 0.5 * math.remainder(to_rad - from_rad, 2.0 * math.pi)
        along, across = self._directions(from_rad + half_rad - self.steer_offset_rad)
        # The mean of cosine and sine over the steering's way, in full.
        twist = rolled_m * along * (math.sin(half_rad) / half_rad if half_rad else 1.0)
        if previous.segment != current.segment or not is_possible(
            abs(float(twist[0])), float(twist[2]), dt_s, self.max_speed_mps, self.max_turn_radps
        ):
            return self.silence(previous.stamp_ns, current.stamp_ns)
        noise = abs(rolled_m) * (
            self.wheel_m2_per_m * np.outer(along, along)
            + self.steer_rad2_m * np.outer(across, across)
            + np.diag([0.0, 0.0, self.yaw_rad2_per_m])
        )
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

    def _directions(self, steer_rad: float) -> tuple[Array, Array]:
        """(3,) base twist for each metre rolled, and its derivative by the steering angle.

        The wheel rolls along (cos, sin) of its angle; the fixed axle lets the base frame go only
        ahead and about its origin: v - omega y = cos, omega wheel_base = sin.
        """
        cos, sin = math.cos(steer_rad), math.sin(steer_rad)
        beside = self.wheel_y_m / self.wheel_base_m
        along = np.array([cos + beside * sin, 0.0, sin / self.wheel_base_m])
        across = np.array([beside * cos - sin, 0.0, cos / self.wheel_base_m])
        return along, across


def _angles(sample: DriveSample) -> tuple[float, float]:
    if not isinstance(sample, JointSample) or sample.names != TricycleDrive.joints:
        raise TypeError("a tricycle needs samples of its drive and steer joints")
    drive_rad, steer_rad = sample.angles_rad
    return drive_rad, steer_rad
