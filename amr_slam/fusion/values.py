"""What the fusion is told and what it answers: its parameters and results."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationParams:
    """What the filter may learn of the wheels while driving, and within which bounds.

    The standard deviations are what is believed before the first fix, of robots as public logs show
    them: scales wrong by up to 10 %, clocks 0.05 to 0.19 s apart.
    """

    learn: bool = True
    """False: the wheels are taken as they come."""
    travel_sigma: Annotated[float, Ge(0)] = 0.05
    """Of the scale of the travel, as a share."""
    travel_limit: Annotated[float, Ge(0)] = 0.15
    """The learned share stays within plus and minus this."""
    yaw_sigma: Annotated[float, Ge(0)] = 0.1
    """Of the scale of the turn, as a share."""
    yaw_limit: Annotated[float, Ge(0)] = 0.3
    """Its bound."""
    bend_radpm: Annotated[float, Ge(0)] = 0.03
    """Of the turn in rad that the wheels do not see in a metre ahead: unequal wheels."""
    bend_limit_radpm: Annotated[float, Ge(0)] = 0.12
    """Its bound in rad per m."""
    lag_sigma_s: Annotated[float, Ge(0)] = 0.05
    """Of the time in s by which the wheels' stamps are later than the scans'."""
    lag_limit_s: Annotated[float, Ge(0)] = 0.25
    """Its bound in s."""
    memory_m: Annotated[float, Gt(0)] = 10000.0
    """Way in m after which the wheels may be others (wear, load, air): what was learned counts no
    more than what was believed before. Nothing is forgotten at a standstill."""

    @property
    def sigmas(self) -> Array:
        """(4,) of travel, yaw, bend and lag; zeros where nothing is to be learned."""
        sigmas = (self.travel_sigma, self.yaw_sigma, self.bend_radpm, self.lag_sigma_s)
        return np.array(sigmas if self.learn else (0.0, 0.0, 0.0, 0.0))

    @property
    def limits(self) -> Array:
        """(4,) of the same."""
        limits = (self.travel_limit, self.yaw_limit, self.bend_limit_radpm, self.lag_limit_s)
        return np.array(limits)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterParams:
    """Parameters of :class:`PoseFilter`."""

    gate_d2: Annotated[float, Gt(0)] = 16.27
    """Squared Mahalanobis distance up to which a fix is taken: 99.9 % of chi2 with 3 dof."""
    gate_d2_inflated: Annotated[float, Gt(0)] = 30.67
    """Up to here (1 - 1e-6) a fix is taken with its covariance scaled by d2 / gate_d2, and the
    wheels are distrusted: after wheel slip good fixes lie outside the gate."""
    slip_factor: Annotated[float, Ge(1)] = 100.0
    """Factor on the wheels' variance over a way on which they slipped or seem to, and less and less
    after: it falls to a third with each fix that the wheels agree with."""
    acceleration_limit_mps2: Annotated[float, Gt(0)] = 3.0
    """No robot speeds up or brakes harder, in m/s2: faster, and the wheels slip."""
    turn_acceleration_limit_radps2: Annotated[float, Gt(0)] = 6.0
    """The same of the turning speed, in rad/s2."""
    fix_inflation: Annotated[float, Ge(1)] = 1.0
    """Factor on every fix's covariance."""
    map_error_m: Annotated[float, Ge(0)] = 0.005
    """Standard deviation in m, per axis, of what the map itself is off, which all fixes nearby
    share: however many there are, the pose becomes no more certain than that."""
    map_error_rad: Annotated[float, Ge(0)] = 0.0015
    """The same of the heading in rad."""
    map_error_range_m: Annotated[float, Gt(0)] = 5.0
    """Way in m (a turn of a radian counts as one) after which e^-1 of the map's error is left."""
    floor_xy_m: Annotated[float, Ge(0)] = 0.002
    """No correction makes the position's standard deviation smaller, in m in any direction."""
    floor_yaw_rad: Annotated[float, Ge(0)] = math.radians(0.05)
    """No correction makes the heading's standard deviation smaller, in rad."""
    history_s: Annotated[float, Ge(10)] = 10.0
    """How old in s a fix may be: 1.5 times the slowest registration at least."""
    future_tolerance_s: Annotated[float, Ge(0)] = 0.005
    """How far in s a fix may lie ahead of the newest wheel sample: clocks and jitter."""
    max_extrapolation_s: Annotated[float, Ge(0)] = 0.1
    """How long in s the last speed is believed without a wheel sample."""
    twist_window_s: Annotated[float, Gt(0)] = 0.1
    """Time in s over which speeds are averaged: one step's quotient is mostly counting noise."""
    acceleration_mps2: Annotated[float, Ge(0)] = 0.5
    """Standard deviation in m/s2 of the acceleration not seen while extrapolating."""
    turn_acceleration_radps2: Annotated[float, Ge(0)] = 1.0
    """Standard deviation in rad/s2 of the turning acceleration not seen while extrapolating."""
    calibration: CalibrationParams = field(default_factory=CalibrationParams)
    """What is learned of the wheels."""

    def __post_init__(self) -> None:
        if self.gate_d2_inflated < self.gate_d2:
            raise ValueError(
                f"gate_d2_inflated ({self.gate_d2_inflated}) is below gate_d2 ({self.gate_d2})"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """What is known of the wheels: (true - nominal), and how well (standard deviations)."""

    travel: float = 0.0
    """The true travel is (1 + this) times what the wheels say."""
    yaw: float = 0.0
    """The same of turns."""
    bend_radpm: float = 0.0
    """Turn in rad that the wheels do not see in each metre ahead."""
    lag_s: float = 0.0
    """By how much the wheels' stamps are later than the scans'."""
    travel_sigma: float = 0.0
    yaw_sigma: float = 0.0
    bend_sigma_radpm: float = 0.0
    lag_sigma_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Slip:
    """The wheels and the scans disagree: by how much, and since when."""

    stamp_ns: int
    """Of the fix that shows it."""
    since_ns: int
    """Of the last fix before, or of the wheel sample before a leap in speed."""
    forward_m: float
    """The robot went so much further ahead than the wheels said."""
    left_m: float
    turn_rad: float
    """And turned so much further to the left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Innovation:
    """How a fix agreed with the prediction, for diagnostics (NIS) and relocalization."""

    stamp_ns: int
    """The fix's."""
    d2: float
    """Squared Mahalanobis distance; chi2 with ``dof`` degrees when both covariances are true."""
    outcome: Outcome
    dof: int = 3
    slip: Slip | None = None
    """INFLATED: what the wheels missed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilterEstimate:
    """What the filter knows at one instant."""

    stamp_ns: int
    """The instant for which it is true."""
    map_from_base: Pose2
    covariance: Array
    """(3, 3) read-only, of (x, y, theta) in the map frame."""
    odom_from_base: Pose2
    """Wheels alone since the filter was made: drifts, never jumps."""
    vx_mps: float
    omega_radps: float
