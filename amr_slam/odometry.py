"""Wheel odometry: two successive samples of one source become one :class:`Motion`.

The noise law is a variance proportional to travel, the only one that does not depend on how often
the wheels are read. It enters along the step, not at its end, so that a step cut into pieces keeps
its covariance, and a standing wheel adds exactly nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Motion, OdometrySample, WheelSample

# Two-point Gauss-Legendre: exact for the cubic, hence for yaw noise acting over a straight step.
_NODES = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))


class Odometry(Protocol):
    """What turns the samples of one source into motions of the base frame."""

    def motion(
        self, previous: WheelSample | OdometrySample, current: WheelSample | OdometrySample
    ) -> Motion:
        """The motion between two successive samples.

        Where the wheels cannot tell (another segment, faster than physics, not finite) the delta
        is the identity, the covariance says how far the robot may have gone meanwhile, and ``gap``
        is True. Raises ValueError when ``current`` is not newer, TypeError for the other kind of
        sample.
        """

    def silence(self, start_ns: int, end_ns: int) -> Motion:
        """A motion without any wheel sample: the identity, as unsure as the drive is fast."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentialDrive:
    """Two driven wheels on one axis: counts to motion (:class:`Odometry`)."""

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

    def motion(
        self, previous: WheelSample | OdometrySample, current: WheelSample | OdometrySample
    ) -> Motion:
        """See :meth:`Odometry.motion`; the arc of a constant twist, noise of both wheels."""
        if not (isinstance(previous, WheelSample) and isinstance(current, WheelSample)):
            raise TypeError("a differential drive needs wheel samples, not integrated poses")
        left_m = self.radius_left_m * (current.left_rad - previous.left_rad)
        right_m = self.radius_right_m * (current.right_rad - previous.right_rad)
        turn_rad = (right_m - left_m) / self.track_m
        travel_m = 0.5 * (abs(left_m) + abs(right_m))
        dt_s = _elapsed_s(previous, current) + self.stamp_jitter_s
        if previous.segment != current.segment or not _possible(
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
            covariance=_along_the_step(twist, noise),
        )

    def silence(self, start_ns: int, end_ns: int) -> Motion:
        """See :meth:`Odometry.silence`."""
        dt_s = 1e-9 * (end_ns - start_ns) + self.stamp_jitter_s
        return _gap(start_ns, end_ns, self.max_speed_mps * dt_s, self.max_turn_radps * dt_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOdometry:
    """Poses that somebody else integrated: differences to motion (:class:`Odometry`).

    The defaults cover the six public logs measured over 2 s each, robots of unknown calibration.
    """

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

    def motion(
        self, previous: WheelSample | OdometrySample, current: WheelSample | OdometrySample
    ) -> Motion:
        """See :meth:`Odometry.motion`; noise by travel and by turn."""
        if not (isinstance(previous, OdometrySample) and isinstance(current, OdometrySample)):
            raise TypeError("integrated poses are needed, not wheel samples")
        delta = _between(previous.odom_from_base, current.odom_from_base)
        travel_m, turn_rad = math.hypot(delta.x_m, delta.y_m), abs(delta.theta_rad)
        dt_s = _elapsed_s(previous, current) + self.stamp_jitter_s
        if previous.segment != current.segment or not _possible(
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
            covariance=_along_the_step(delta.log(), noise),
        )

    def silence(self, start_ns: int, end_ns: int) -> Motion:
        """See :meth:`Odometry.silence`."""
        dt_s = 1e-9 * (end_ns - start_ns) + self.stamp_jitter_s
        return _gap(start_ns, end_ns, self.max_speed_mps * dt_s, self.max_turn_radps * dt_s)


def _elapsed_s(
    previous: WheelSample | OdometrySample, current: WheelSample | OdometrySample
) -> float:
    if current.stamp_ns <= previous.stamp_ns:
        raise ValueError(f"sample at {current.stamp_ns} ns is not newer than {previous.stamp_ns}")
    return 1e-9 * (current.stamp_ns - previous.stamp_ns)


def _between(start: Pose2, end: Pose2) -> Pose2:
    """start_from_end. From differences, so that equal poses give exactly nothing anywhere."""
    dx_m, dy_m = end.x_m - start.x_m, end.y_m - start.y_m
    c, s = math.cos(start.theta_rad), math.sin(start.theta_rad)
    return Pose2(c * dx_m + s * dy_m, c * dy_m - s * dx_m, end.theta_rad - start.theta_rad)


def _possible(
    travel_m: float, turn_rad: float, dt_s: float, max_speed_mps: float, max_turn_radps: float
) -> bool:
    """False for what is not finite as well."""
    return travel_m <= max_speed_mps * dt_s and abs(turn_rad) <= max_turn_radps * dt_s


def _gap(start_ns: int, end_ns: int, reach_m: float, turn_rad: float) -> Motion:
    """Nothing known but how far the robot can have gone (1 sigma in m and rad)."""
    return Motion(
        start_ns=start_ns,
        end_ns=end_ns,
        delta=Pose2.identity(),
        covariance=np.diag([reach_m**2, reach_m**2, turn_rad**2]),
        gap=True,
    )


def _along_the_step(twist: Array, noise: Array) -> Array:
    """Covariance (3, 3) at the end of a step of constant ``twist`` (m, m, rad).

    ``noise`` (3, 3) is the whole step's, in the moving body frame, spread evenly over it: the
    integral of Ad(rest^-1) noise Ad(rest^-1)' over the step, where rest is the way still to go.
    """
    covariance = np.zeros((3, 3))
    for node in _NODES:
        carry = Pose2.exp(-node * twist).adjoint()
        covariance += 0.5 * (carry @ noise @ carry.T)
    return covariance
