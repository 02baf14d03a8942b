"""Wheels against scans and against physics: what a slipping or a stuck wheel looks like."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.fusion.trail import Reported, Trail
from amr_slam.fusion.values import FilterParams, Slip
from amr_slam.geometry import Array, Pose2

LEAP_NS: Final = 200_000_000
"""Mean speeds over this time are compared: one step's quotient is counting noise, and logs bunch
their stamps."""
_LEAST_SAMPLES: Final = 8
# What wheels may miss at most: all of the way they report, a bit of way, and turns to match.
_WHOLE: Final = 1.1
_REVERSED: Final = 2.2
_REACH_M: Final = 0.1
_REACH_RAD: Final = 0.1
_TURN_RADPM: Final = 3.0
# What is too small to be told to anybody.
_LEAST_M: Final = 0.05
_LEAST_RAD: Final = 0.05


def missed(expected: Pose2, found: Pose2) -> Pose2:
    """How much further the robot went than the wheels said, in its own frame."""
    return expected.inverse() @ found


def explicable(error: Pose2, reported: Reported) -> Array | None:
    """(3, 3) covariance in the body frame of what wheels may have missed, where that can be all
    of ``error``; None where they cannot have: then the fix is wrong or the robot was carried.

    A wheel that spins reports at most a way that the robot did not go, and one that is dragged or
    stands still at most the other wheel's.
    """
    reach_m, reach_rad = _reach(reported, _WHOLE)
    if not _within(error, reach_m, reach_rad):
        return None
    return np.diag([reach_m**2, reach_m**2, reach_rad**2])


def suspicious(error: Pose2, reported: Reported) -> bool:
    """Whether the wheels may be the ones that lie: they may even have mistaken back for forth."""
    return _within(error, *_reach(reported, _REVERSED))


def _reach(reported: Reported, share: float) -> tuple[float, float]:
    reach_m = _REACH_M + share * reported.travel_m
    return reach_m, _REACH_RAD + _TURN_RADPM * reported.travel_m + share * reported.turn_rad


def _within(error: Pose2, reach_m: float, reach_rad: float) -> bool:
    return max(abs(error.x_m), abs(error.y_m)) <= reach_m and abs(error.theta_rad) <= reach_rad


def told(since_ns: int, stamp_ns: int, error: Pose2) -> Slip | None:
    """The event, where it is large enough to be told."""
    if error.distance_to(Pose2.identity()) < _LEAST_M and abs(error.theta_rad) < _LEAST_RAD:
        return None
    return Slip(
        stamp_ns=stamp_ns,
        since_ns=since_ns,
        forward_m=error.x_m,
        left_m=error.y_m,
        turn_rad=error.theta_rad,
    )


def leaps(trail: Trail, params: FilterParams) -> bool:
    """Whether the wheels changed their speed, from one moment to the next, faster than any robot
    can. Wheels that are read too seldom do not show that."""
    now_ns, middle_ns = trail.end_ns, trail.end_ns - LEAP_NS
    early_ns = middle_ns - LEAP_NS
    if early_ns < trail.start_ns or trail.samples_since(early_ns) < _LEAST_SAMPLES:
        return False
    leap = trail.twist_rate(middle_ns, now_ns) - trail.twist_rate(early_ns, middle_ns)
    took_s = 1e-9 * LEAP_NS
    return bool(
        abs(leap[0]) > params.acceleration_limit_mps2 * took_s
        or abs(leap[2]) > params.turn_acceleration_limit_radps2 * took_s
    )
