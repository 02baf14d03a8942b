"""The product on a simulated drive: the daemon's localizer, fed with wheels and ready fixes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from amr_slam.clouds import CloudParams
from amr_slam.evidence import Answer, Rung, Verdict
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.localizer import Localizer, LocalizerParams
from amr_slam.samples import PoseEstimate, SlamPose
from amr_slam.slam_request import SlamResult
from amr_slam.studies.fusion.simulated import DRIVE, Recording

_ANSWER = Answer(verdict=Verdict.ACCEPTED, rung=Rung.RELATIVE, candidates=1, margin=1.0)


def localizer(params: FilterParams, start: Pose2, covariance: Array) -> Localizer:
    """For drives that begin at a pose roughly known."""
    return Localizer(
        LocalizerParams(), params, CloudParams(), DRIVE, {}, "localization", (start, covariance)
    )


def result_of(fix: SlamPose) -> SlamResult:
    """What the registration would hand back with this fix."""
    return SlamResult(
        stamp_ns=fix.stamp_ns,
        answer=_ANSWER,
        climbed=(_ANSWER,),
        fix=fix,
        inserted=False,
        map_scans=1,
    )


def estimates(
    drive: Recording, robot: Localizer, every: int = 1
) -> Iterator[tuple[PoseEstimate, Pose2]]:
    """The published pose and the true one at each ``every``-th wheel sample."""
    waiting = list(drive.fixes)
    for row, (sample, truth) in enumerate(zip(drive.wheels, drive.truth, strict=True)):
        robot.handle(sample)
        while waiting and waiting[0][0] <= sample.stamp_ns:
            robot.handle(result_of(waiting.pop(0)[1]))
        estimate = robot.estimate(sample.stamp_ns) if row % every == 0 else None
        if estimate is not None:
            yield estimate, truth


def off(estimate: Pose2, truth: Pose2) -> Array:
    """(3,) estimate less truth, angle wrapped."""
    error = estimate.as_array() - truth.as_array()
    error[2] = wrap_angle(float(error[2]))
    return np.asarray(error)


def twist_off(estimate: Pose2, truth: Pose2) -> Array:
    """(3,) the twist from the estimate to the truth, along the axes of the map: what the covariance
    of a pose is about."""
    axes = Pose2(0.0, 0.0, estimate.theta_rad).adjoint()
    return np.asarray(axes @ (estimate.inverse() @ truth).log())
