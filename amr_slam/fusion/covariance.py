"""Covariances (3, 3) of (x, y, theta): what may be used, floors, and the error in one number."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Motion

# Nothing in a factory is larger, and no fix has a smaller standard deviation (m, rad).
_LARGEST = 1e9
_SMALLEST_SIGMA = 1e-5


def error95_m(covariance: Array) -> float:
    """Radius in m that the position error does not exceed in 95 % of the cases.

    ``covariance`` is (2, 2) or (3, 3) with x, y first, in m2. For a Gaussian of standard deviations
    s1 >= s2 along its axes the radius is s1 k(s2 / s1), with k from 1.960 (a line) to 2.448 (a
    circle); the polynomial for k was fitted to the integral and is within 0.04 % of it.
    """
    mean = 0.5 * (covariance[0, 0] + covariance[1, 1])
    spread = math.hypot(0.5 * (covariance[0, 0] - covariance[1, 1]), covariance[0, 1])
    major, minor = mean + spread, max(mean - spread, 0.0)
    if major <= 0.0:
        return 0.0
    ratio = math.sqrt(minor / major)
    factor = 0.0
    for coefficient in (-0.943107, 2.085651, -1.146612, 0.509708, -0.018469, 1.960158):
        factor = factor * ratio + coefficient
    return math.sqrt(major) * factor


def symmetric(P: Array) -> Array:
    """P without the asymmetry that rounding left in it."""
    half: Array = 0.5 * (P + P.T)
    return half


def floored(P: Array, floor_xy_m: float, floor_yaw_rad: float) -> Array:
    """P with what is missing to the floors added: in every direction of the plane alike."""
    variances, axes = np.linalg.eigh(P[:2, :2])
    missing = np.maximum(floor_xy_m**2 - variances, 0.0)
    raised = P.copy()
    raised[:2, :2] += (axes * missing) @ axes.T
    raised[2, 2] = max(raised[2, 2], floor_yaw_rad**2)
    return raised


def usable_pose(pose: Pose2) -> bool:
    """Finite and inside anything that a robot drives in."""
    # Comparisons with NaN are false.
    return abs(pose.x_m) <= _LARGEST and abs(pose.y_m) <= _LARGEST and pose.is_finite()


def sound(x: Array, P: Array) -> bool:
    """Whether a state (n,) and its covariance (n, n) are numbers that can be gone on with."""
    return (
        bool(np.isfinite(x).all())
        and bool(np.abs(P).max() <= _LARGEST)
        and bool(np.diag(P).min() >= 0.0)
        and bool(np.linalg.eigvalsh(P[:3, :3])[0] >= 0.0)
    )


def usable_covariance(P: Array, smallest_sigma: float = _SMALLEST_SIGMA) -> bool:
    """Finite, symmetric, no direction more certain than anything measures."""
    return (
        P.shape == (3, 3)
        and bool(np.abs(P).max() <= _LARGEST)
        and bool(np.abs(P - P.T).max() <= 1e-9 * np.abs(P).max())
        and bool(np.linalg.eigvalsh(P)[0] >= smallest_sigma**2)
    )


def usable_motion(motion: Motion) -> bool:
    """Finite, covariance symmetric and positive semi-definite up to rounding."""
    Q = motion.covariance
    if not (usable_pose(motion.delta) and np.abs(Q).max() <= _LARGEST):
        return False
    slack = 1e-9 * float(Q.trace())
    return bool(np.abs(Q - Q.T).max() <= slack and np.linalg.eigvalsh(Q)[0] >= -slack)
