"""Whether two poses are one place: under the wheels' motion, within what both claim."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from amr_slam.evidence import Hypothesis
from amr_slam.geometry import Array, Pose2, inverse_matrix, turned, wrap_angle
from amr_slam.samples import Motion

# Two poses agree when their squared Mahalanobis distance is below this (99.9 %, 3 dof).
AGREE_D2: Final = 16.27
# However unsure the wheels are, a place farther off (m, rad) is another one: a wide gate would
# take any place for a confirmation.
_REACH: Final = np.array([1.0, 1.0, 0.35])
# What an alignment knows at least, in 1/m2, 1/m2, 1/rad2: along a corridor it may know nothing.
_FLOOR: Final = 1e-4 * np.eye(3)


def moved(pose: Pose2, covariance: Array, motion: Motion) -> tuple[Pose2, Array]:
    """Pose and covariance (3, 3) in the map frame after a motion of the base."""
    after = pose @ motion.delta
    carry = np.eye(3)
    carry[:2, 2] = [-(after.y_m - pose.y_m), after.x_m - pose.x_m]
    spread = carry @ covariance @ carry.T + turned(motion.covariance, after.rotation)
    return after, 0.5 * (spread + spread.T)


def covariance_of(found: Hypothesis) -> Array:
    """(3, 3) of a refined pose, from the scan's points alone."""
    return inverse_matrix(found.alignment.information + _FLOOR)


def agreement_d2(expected: Pose2, found: Pose2, spread: Array) -> float:
    """Squared Mahalanobis distance of two poses under covariance (3, 3); inf where they lie
    farther apart than any wheels err between two scans."""
    difference = _difference(expected, found)
    if np.any(np.abs(difference) > _REACH):
        return math.inf
    return float(difference @ inverse_matrix(spread) @ difference)


def _difference(expected: Pose2, found: Pose2) -> Array:
    difference = found.as_array() - expected.as_array()
    difference[2] = wrap_angle(float(difference[2]))
    return difference


def fused(
    pose: Pose2, covariance: Array, found: Pose2, found_covariance: Array
) -> tuple[Pose2, Array]:
    """A pose corrected by another measurement of it: along a corridor, of which a scan tells
    nothing, the way of the wheels remains."""
    gain = covariance @ inverse_matrix(covariance + found_covariance)
    corrected = pose.as_array() + gain @ _difference(pose, found)
    remaining = (np.eye(3) - gain) @ covariance
    return Pose2.from_array(corrected), 0.5 * (remaining + remaining.T)
