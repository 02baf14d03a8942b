"""What the fusion is told and what it answers: its parameters and results."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterParams:
    """Parameters of :class:`PoseFilter`."""

    gate_d2: Annotated[float, Gt(0)] = 16.27
    """Squared Mahalanobis distance up to which a fix is taken: 99.9 % of chi2 with 3 dof."""
    gate_d2_inflated: Annotated[float, Gt(0)] = 30.67
    """Up to here (1 - 1e-6) a fix is taken with its covariance scaled by d2 / gate_d2: after wheel
    slip good fixes lie outside the gate, and a gate alone would refuse them for ever."""
    fix_inflation: Annotated[float, Ge(1)] = 2.0
    """Factor on every fix's covariance, as fixes from one map share its errors. Over 100 simulated
    runs, errors of successive fixes correlated by 0 / 0.5 / 0.7 / 0.8, a factor of 2 gave a NEES of
    2.4 / 2.9 / 3.4 / 3.7 (3 is honest), a factor of 1 gave 2.8 / 3.7 / 4.3 / 4.7."""
    floor_xy_m: Annotated[float, Ge(0)] = 0.005
    """No correction makes the position's standard deviation smaller, in m in any direction."""
    floor_yaw_rad: Annotated[float, Ge(0)] = math.radians(0.1)
    """No correction makes the heading's standard deviation smaller, in rad."""
    history_s: Annotated[float, Ge(10)] = 10.0
    """How old in s a fix may be: 1.5 times the slowest registration at least."""
    future_tolerance_s: Annotated[float, Ge(0)] = 0.005
    """How far in s a fix may lie ahead of the newest wheel sample: clocks and jitter."""
    max_extrapolation_s: Annotated[float, Ge(0)] = 0.1
    """How long in s the last speed is believed without a wheel sample."""
    twist_window_s: Annotated[float, Gt(0)] = 0.1
    """Time in s over which speeds are averaged: one step's quotient is mostly counting noise."""
    acceleration_mps2: Annotated[float, Ge(0)] = 1.0
    """Standard deviation in m/s2 of the acceleration not seen while extrapolating."""
    turn_acceleration_radps2: Annotated[float, Ge(0)] = 2.0
    """Standard deviation in rad/s2 of the turning acceleration not seen while extrapolating."""

    def __post_init__(self) -> None:
        if self.gate_d2_inflated < self.gate_d2:
            raise ValueError(
                f"gate_d2_inflated ({self.gate_d2_inflated}) is below gate_d2 ({self.gate_d2})"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Innovation:
    """How a fix agreed with the prediction, for diagnostics (NIS) and relocalization."""

    stamp_ns: int
    """The fix's."""
    d2: float
    """Squared Mahalanobis distance; chi2 with ``dof`` degrees when both covariances are true."""
    outcome: Outcome
    dof: int = 3


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
