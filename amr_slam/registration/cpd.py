"""Coherent Point Drift, rigid: the paper's second strategy (section 2.1).

Source: A. Myronenko, X. Song, "Point Set Registration: Coherent Point Drift", 2010, figure 2
(rigid registration) with the scale fixed to 1. The target's points are data, the source's points
are the centroids of a Gaussian mixture with an outlier share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2, rotation_matrix
from amr_slam.registration.alignment import Alignment, Target

# Square metres: finer than any scanner, and the mixture's densities stay numbers.
_LEAST_VARIANCE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class CpdParams:
    """Outliers, size of the problem, termination."""

    outliers: Annotated[float, Ge(0.0), Lt(1.0)] = 0.3
    """Weight of the uniform component: target points that the source does not have."""
    max_points: Annotated[int, Ge(10), Le(5000)] = 250
    """Both sets are thinned to this many: the cost is their product."""
    max_iterations: Annotated[int, Ge(1), Le(1000)] = 50
    """Most expectation-maximization rounds."""
    tolerance: Annotated[float, Gt(0.0)] = 1e-5
    """Relative change of the variance that ends the iteration."""


def align(source: Cloud, target: Target, initial: Pose2, params: CpdParams) -> Alignment:
    """Rough ``target_from_source`` by rigid CPD from ``initial``.

    The information is that of the final mixture's variance over the matched weight.
    """
    points = initial @ thin(source.points_m, params.max_points)
    data = thin(target.points_m, params.max_points)
    if len(points) < 3 or len(data) < 3:
        return _result(initial, 0.0, 0.0, 0, converged=False)
    rotation, translation = np.eye(2), np.zeros(2)
    # Differences of large numbers: points all in one place may come out below nothing.
    variance = max(_spread(data, points), _LEAST_VARIANCE)
    weight, iteration, converged = 0.0, 0, False
    while iteration < params.max_iterations and not converged:
        iteration += 1
        probability = expectation(
            data, points @ rotation.T + translation, variance, params.outliers
        )
        rotation, translation, new_variance, weight = maximization(data, points, probability)
        converged = abs(new_variance - variance) <= params.tolerance * variance
        variance = max(new_variance, _LEAST_VARIANCE)
    correction = Pose2(
        translation[0], translation[1], math.atan2(rotation[1, 0], rotation[0, 0])
    )  # fmt: skip
    return _result(
        correction @ initial, variance, weight / len(points), iteration, converged=converged
    )


def thin(points: Array, most: int) -> Array:
    """At most ``most`` of the points, evenly spread over their order (deterministic)."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).round().astype(np.int64)]


def _spread(data: Array, points: Array) -> float:
    """Initial variance: mean squared distance of all pairs over the dimension."""
    total = (
        len(points) * np.sum(data**2)
        + len(data) * np.sum(points**2)
        - 2.0 * np.sum(data, axis=0) @ np.sum(points, axis=0)
    )
    return float(total / (2.0 * len(data) * len(points)))


def expectation(data: Array, moved: Array, variance: float, outliers: float) -> Array:
    """E-step: (m, n) probability that centroid ``moved`` (m, 2) produced ``data`` (n, 2)."""
    squared = (moved[:, 0:1] - data[:, 0]) ** 2 + (moved[:, 1:2] - data[:, 1]) ** 2
    density = np.exp(-squared / (2.0 * variance))
    uniform = math.tau * variance * outliers / (1.0 - outliers) * len(moved) / len(data)
    normaliser = density.sum(axis=0) + uniform
    return np.asarray(density / np.maximum(normaliser, 1e-300))


def maximization(
    data: Array, points: Array, probability: Array
) -> tuple[Array, Array, float, float]:
    """M-step: rotation (2, 2), translation (2,), variance, and the total matched weight."""
    per_data, per_point = probability.sum(axis=0), probability.sum(axis=1)
    weight = max(float(per_data.sum()), 1e-300)
    mean_data, mean_points = per_data @ data / weight, per_point @ points / weight
    x, y = data - mean_data, points - mean_points
    a = (probability @ x).T @ y
    turn = math.atan2(a[1, 0] - a[0, 1], a[0, 0] + a[1, 1])
    rotation = rotation_matrix(turn)
    translation = mean_data - rotation @ mean_points
    trace = float(np.sum(a * rotation))
    residual = per_data @ np.sum(x**2, axis=1) - 2.0 * trace + per_point @ np.sum(y**2, axis=1)
    return rotation, translation, float(residual / (2.0 * weight)), weight


def _result(
    pose: Pose2, variance: float, matched: float, iterations: int, *, converged: bool
) -> Alignment:
    information = np.zeros((3, 3))
    if variance > 0.0:
        information = np.eye(3) * (matched / variance)
    return Alignment(
        target_from_source=pose,
        information=information,
        converged=converged,
        iterations=iterations,
        inliers=min(matched, 1.0),
        rmse_m=math.sqrt(variance),
    )
