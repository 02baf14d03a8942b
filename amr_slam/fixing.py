"""What a registered scan is worth: with the wheels beside it, and as a measurement of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from amr_slam.agreement import fused
from amr_slam.evidence import Hypothesis, Rung
from amr_slam.geometry import Pose2, inverse_matrix, wrap_angle
from amr_slam.registration.icp import Prior, points_alone
from amr_slam.samples import SlamPose
from amr_slam.slam_request import SlamRequest

# Added to the prior's covariance: scan stamps, mounting and sweep are never exact.
_SLACK = np.diag([0.02**2, 0.02**2, 0.01**2])
# Largest covariance that a fix may carry (m2, m2, rad2): "nothing known" in numbers.
_FIX_LIMIT = 1e4
_COMPATIBLE_D2 = 30.67
# What walls that lie off by a metre do to a pose: rooms are some metres wide, so they turn it less.
_BY_MAP_ERROR = np.diag([1.0, 1.0, 1.0 / 3.0**2])


def prior_of(request: SlamRequest) -> Prior | None:
    """What is expected, made a little less sure; None where nothing is."""
    if request.map_from_base is None or request.covariance is None:
        return None
    return Prior(
        target_from_source=request.map_from_base,
        information=inverse_matrix(request.covariance + _SLACK),
    )


def among_others(request: SlamRequest, prior: Prior) -> SlamRequest:
    """The request for a search of the whole map that tries the expected pose as well."""
    expected = prior.target_from_source.as_array()[np.newaxis]
    others = expected if request.also is None else np.concatenate([expected, request.also])
    return replace(request, also=others)


def compatible(fix: SlamPose, prior: Prior) -> bool:
    """Whether fix and prior can both be true (1 - 1e-6, 3 dof): a scan that contradicts the
    wheels must not enter the map."""
    difference = fix.map_from_base.as_array() - prior.target_from_source.as_array()
    difference[2] = wrap_angle(float(difference[2]))
    spread = fix.covariance + inverse_matrix(prior.information)
    return float(difference @ inverse_matrix(spread) @ difference) <= _COMPATIBLE_D2


def placed(request: SlamRequest, rung: Rung, best: Hypothesis, fix: SlamPose) -> Pose2:
    """Where an accepted scan was taken, by scan and wheels together.

    A search knows nothing of the wheels: along a corridor any place will do for it.
    """
    if rung is Rung.RELATIVE or request.map_from_base is None or request.covariance is None:
        return best.pose
    expected, covariance = request.map_from_base, request.covariance
    return fused(expected, covariance, fix.map_from_base, fix.covariance)[0]


def fix_of(
    stamp_ns: int, best: Hypothesis, rung: Rung, prior: Prior | None, map_error_m: float
) -> SlamPose:
    """The accepted pose as a measurement of its own: without the prior that helped to find it."""
    alignment = best.alignment
    relocalized = rung is not Rung.RELATIVE
    if prior is None or relocalized:
        floor = np.eye(3) / _FIX_LIMIT
        pose, covariance = best.pose, inverse_matrix(alignment.information + floor)
    else:
        pose, covariance = points_alone(alignment, prior)
    covariance = covariance + map_error_m**2 * _BY_MAP_ERROR
    scale = min(1.0, _FIX_LIMIT / float(np.trace(covariance)))
    return SlamPose(
        stamp_ns=stamp_ns,
        map_from_base=pose,
        covariance=scale * covariance,
        relocalized=relocalized,
    )
