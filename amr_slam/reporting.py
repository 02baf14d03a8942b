"""Estimates and measurements as messages, and messages as poses again."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Candidate, Health, PoseEstimate
from amr_slam.wire import (
    MAX_SCAN_POINTS,
    UNKNOWN,
    CandidatePart,
    HealthPart,
    OdomPose,
    PoseMessage,
    ScanMessage,
)


def pose_message(
    estimate: PoseEstimate,
    *,
    robot: str,
    seq: int,
    utc_from_monotonic_ns: int,
    map_id: str | None,
) -> PoseMessage:
    """``utc_from_monotonic_ns`` + the estimate's stamp is UTC in ns. Raises ValueError when the
    pose, its covariance or a speed is not finite: nothing is repaired on the way out."""
    pose, odom = estimate.map_from_base, estimate.odom_from_base
    return PoseMessage(
        robot=robot,
        seq=seq,
        stamp=_utc_s(estimate.stamp_ns, utc_from_monotonic_ns),
        age_s=estimate.wheel_age_s,
        map=map_id,
        epoch=estimate.epoch,
        x=pose.x_m,
        y=pose.y_m,
        theta=pose.theta_rad,
        vx=estimate.vx_mps,
        omega=estimate.omega_radps,
        covariance=tuple(estimate.covariance.ravel().tolist()),
        error95_m=min(estimate.error95_m, UNKNOWN),
        state=estimate.state,
        since_fix_s=min(estimate.since_fix_s, UNKNOWN),
        since_fix_m=min(estimate.since_fix_m, UNKNOWN),
        odom=OdomPose(x=odom.x_m, y=odom.y_m, theta=odom.theta_rad),
        fault=estimate.fault,
    )


def scan_message(
    points_m: Array,
    *,
    robot: str,
    seq: int,
    stamp_ns: int,
    utc_from_monotonic_ns: int,
    map_id: str | None,
    epoch: int,
) -> ScanMessage:
    """``points_m``: (n, 2) in the map frame, in the order of the beams; every k-th is sent, so
    that they are few enough, rounded to mm. Raises ValueError when one is not finite."""
    every = max(1, -(-len(points_m) // MAX_SCAN_POINTS))
    rounded = np.round(points_m[::every], 3)
    return ScanMessage(
        robot=robot,
        seq=seq,
        stamp=_utc_s(stamp_ns, utc_from_monotonic_ns),
        map=map_id,
        epoch=epoch,
        points=tuple((x, y) for x, y in rounded.tolist()),
    )


def map_from_base(message: PoseMessage) -> Pose2:
    """The pose in a message."""
    return Pose2(message.x, message.y, message.theta)


def health_part(health: Health) -> HealthPart:
    """A device's health for a status message."""
    return HealthPart.model_validate({**asdict(health), "link": health.link.name})


def candidate_part(candidate: Candidate) -> CandidatePart:
    """A place where the robot may be, for a status message."""
    pose = candidate.map_from_base
    return CandidatePart(x=pose.x_m, y=pose.y_m, theta=pose.theta_rad, odds=candidate.odds)


def _utc_s(stamp_ns: int, utc_from_monotonic_ns: int) -> float:
    # By an int: ns above 2^53 would be rounded twice.
    return (stamp_ns + utc_from_monotonic_ns) / 1_000_000_000
