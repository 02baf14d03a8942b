"""What a drive is, and the parts that every drive is made of."""

from __future__ import annotations

import math
from typing import ClassVar, Final, Protocol

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import DriveSample, JointSample, Motion, WheelSample

# Two-point Gauss-Legendre: exact for the cubic, hence for yaw noise acting over a straight step.
_NODES: Final = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))


class Odometry(Protocol):
    """What turns the samples of one source into motions of the base frame."""

    joints: ClassVar[tuple[str, ...]]
    """Names of the joints whose angles are needed, in this order; ``("left", "right")`` come in a
    :class:`WheelSample`, others in a :class:`JointSample`; none: integrated poses."""

    def motion(self, previous: DriveSample, current: DriveSample) -> Motion:
        """The motion between two successive samples.

        Where the wheels cannot tell (another segment, faster than physics, not finite) the delta
        is the identity, the covariance says how far the robot may have gone meanwhile, and ``gap``
        is True. Raises ValueError when ``current`` is not newer, TypeError for another kind of
        sample.
        """

    def silence(self, start_ns: int, end_ns: int) -> Motion:
        """A motion without any wheel sample: the identity, as unsure as the drive is fast."""


def joints_of(sample: DriveSample) -> tuple[str, ...]:
    """Names of the joints whose angles the sample tells; none: it is an integrated pose."""
    if isinstance(sample, WheelSample):
        return ("left", "right")
    return sample.names if isinstance(sample, JointSample) else ()


def elapsed_s(previous: DriveSample, current: DriveSample) -> float:
    """Time between two samples in s. Raises ValueError when ``current`` is not newer."""
    if current.stamp_ns <= previous.stamp_ns:
        raise ValueError(f"sample at {current.stamp_ns} ns is not newer than {previous.stamp_ns}")
    return 1e-9 * (current.stamp_ns - previous.stamp_ns)


def is_possible(
    travel_m: float, turn_rad: float, dt_s: float, max_speed_mps: float, max_turn_radps: float
) -> bool:
    """Whether the drive can have done this in ``dt_s``; False for what is not finite as well."""
    return travel_m <= max_speed_mps * dt_s and abs(turn_rad) <= max_turn_radps * dt_s


def gap(start_ns: int, end_ns: int, reach_m: float, turn_rad: float) -> Motion:
    """Nothing known but how far the robot can have gone (1 sigma in m and rad)."""
    return Motion(
        start_ns=start_ns,
        end_ns=end_ns,
        delta=Pose2.identity(),
        covariance=np.diag([reach_m**2, reach_m**2, turn_rad**2]),
        gap=True,
    )


def along_the_step(twist: Array, noise: Array) -> Array:
    """Covariance (3, 3) at the end of a step of constant ``twist`` (m, m, rad).

    ``noise`` (3, 3) is the whole step's, in the moving body frame, spread evenly over it: the
    integral of Ad(rest^-1) noise Ad(rest^-1)' over the step, where rest is the way still to go.
    """
    covariance = np.zeros((3, 3))
    for node in _NODES:
        carry = Pose2.exp(-node * twist).adjoint()
        covariance += 0.5 * (carry @ noise @ carry.T)
    return covariance
