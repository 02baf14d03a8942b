"""How exactly a scan can tell the pose, over the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.commissioning.places import components, thinned
from amr_slam.commissioning.settings import ReportParams
from amr_slam.commissioning.viewing import Eye, all_around, seen
from amr_slam.fusion import error95_m
from amr_slam.geometry import Array, Pose2, inverse_matrix
from amr_slam.params import SlamParams
from amr_slam.registration import icp
from amr_slam.registration.alignment import Target

# "Nothing known": what a fix of the engine carries at most (m2, rad2).
_LIMIT = 1e4
_LEAST_PLACES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weakness:
    """An area in which the expected error is poor."""

    rows: NDArray[np.intp]
    """Of the places in it."""
    middle_m: Array
    """(2,) the place nearest to its middle."""
    axis_rad: float
    """Direction in the map along which the scans tell least, -pi/2 to pi/2."""
    median_m: float
    """Of the expected errors in it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Precision:
    """The expected error at places of the floor."""

    places_m: Array
    """(n, 2)."""
    spacing_m: float
    poses: Array
    """(n, 3) with the heading, the worst one where several were looked at."""
    error95_m: Array
    """(n,) radius that the error of one scan's position does not exceed in 95 % of the cases."""
    axes_rad: Array
    """(n,) direction along which it is largest, -pi/2 to pi/2."""
    ratios: Array
    """(n,) by how much that direction is worse than the one across."""
    weak: tuple[Weakness, ...]
    """Largest first."""

    def share(self, up_to_m: float) -> float:
        """Of the places, with an expected error up to this."""
        return float(np.mean(self.error95_m <= up_to_m)) if len(self.error95_m) else 0.0


def precision(
    target: Target,
    eyes: Sequence[Eye],
    places: Array,
    slam: SlamParams,
    params: ReportParams,
) -> Precision:
    """``places`` (n, 2), ``slam.grid_m`` apart: where the robot may stand."""
    chosen, spacing_m = thinned(places, params.precision_places, slam.grid_m)
    rng = np.random.default_rng((params.seed, 1))
    turns = 1 if all_around(eyes) else 4
    begin = rng.uniform(-math.pi, math.pi, len(chosen))
    poses, covariances = np.empty((len(chosen), 3)), np.empty((len(chosen), 3, 3))
    for row, place in enumerate(chosen):
        worst = -1.0
        for turn in range(turns):
            pose = Pose2(place[0], place[1], begin[row] + turn * math.tau / turns)
            covariance = expected_covariance(target, eyes, pose, slam, rng)
            if error95_m(covariance) > worst:
                worst = error95_m(covariance)
                poses[row], covariances[row] = pose.as_array(), covariance
    errors = np.array([error95_m(one) for one in covariances])
    variances, directions = np.linalg.eigh(covariances[:, :2, :2])
    axes = np.arctan(
        directions[:, 1, 1] / np.where(directions[:, 0, 1] == 0.0, 1e-12, directions[:, 0, 1])
    )
    return Precision(
        places_m=chosen,
        spacing_m=spacing_m,
        poses=poses,
        error95_m=errors,
        axes_rad=axes,
        ratios=np.sqrt(variances[:, 1] / np.maximum(variances[:, 0], 1e-12)),
        weak=_weak(chosen, errors, axes, spacing_m, params.poor_m),
    )


def expected_covariance(
    target: Target, eyes: Sequence[Eye], pose: Pose2, slam: SlamParams, rng: np.random.Generator
) -> Array:
    """(3, 3) of the fix that the engine would make of the scan at this pose: the registration's
    own, begun at the truth."""
    cloud = seen(target, eyes, pose, rng, slam.clouds)
    information = icp.align(cloud, target, pose, slam.icp).information
    return inverse_matrix(information + np.eye(3) / _LIMIT)


def _weak(
    places: Array, errors: Array, axes: Array, spacing_m: float, poor_m: float
) -> tuple[Weakness, ...]:
    rows = np.flatnonzero(errors > poor_m)
    if not len(rows):
        return ()
    groups = components(places[rows], 1.6 * spacing_m)
    found = []
    for group in range(int(groups.max()) + 1):
        mine = rows[groups == group]
        if len(mine) < _LEAST_PLACES:
            continue
        middle = places[mine].mean(axis=0)
        nearest = mine[np.argmin(np.hypot(*(places[mine] - middle).T))]
        # The mean of directions without a sign is that of their doubles.
        double = np.exp(2j * axes[mine]).mean()
        found.append(
            Weakness(
                rows=mine,
                middle_m=places[nearest],
                axis_rad=float(0.5 * np.angle(double)),
                median_m=float(np.median(errors[mine])),
            )
        )
    return tuple(sorted(found, key=lambda one: -len(one.rows)))
