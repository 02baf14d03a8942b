"""Estimates and measurements as messages, and messages as poses again."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from amr_slam.fusion import Calibration
from amr_slam.geometry import Array, Pose2
from amr_slam.living import ChangeCounts, MapDiff
from amr_slam.samples import Candidate, Health, PoseEstimate
from amr_slam.wheel_events import WheelEvent
from amr_slam.wire import (
    MAX_CHANGES,
    MAX_SCAN_POINTS,
    UNKNOWN,
    CalibrationPart,
    CandidatePart,
    ChangePart,
    ChangesPart,
    EpochDelta,
    HealthPart,
    MapChanges,
    OdomPose,
    PoseMessage,
    ScanMessage,
    SlipPart,
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
    delta = estimate.epoch_delta
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
        epoch_delta=None
        if delta is None
        else EpochDelta(x=delta.x_m, y=delta.y_m, theta=delta.theta_rad),
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


def changes_part(counts: ChangeCounts) -> ChangesPart:
    """What has been watched of the map's changes."""
    since_s = counts.oldest_since_s
    return ChangesPart(
        new=counts.new,
        gone=counts.gone,
        oldest_since=None if since_s is None else max(0.0, since_s),
    )


def map_changes(diff: MapDiff, map_id: str) -> MapChanges:
    """The list of them: of too many the largest."""
    largest = sorted(diff.changes, key=lambda change: -change.area_m2)[:MAX_CHANGES]
    return MapChanges(
        map=map_id,
        total=len(diff.changes),
        changes=tuple(
            ChangePart(
                number=change.number,
                what=change.kind,
                box=tuple(round(side_m, 3) for side_m in change.box_m),
                since=None if change.since_s is None else round(max(0.0, change.since_s), 1),
                seen=None if change.seen_s is None else round(max(0.0, change.seen_s), 1),
                passes=change.passes,
            )
            for change in sorted(largest, key=lambda change: change.number)
        ),
    )


def candidate_part(candidate: Candidate) -> CandidatePart:
    """A place where the robot may be, for a status message."""
    pose = candidate.map_from_base
    return CandidatePart(x=pose.x_m, y=pose.y_m, theta=pose.theta_rad, odds=candidate.odds)


def calibration_part(known: Calibration) -> CalibrationPart:
    """What was learned of the wheels, for a status message."""
    return CalibrationPart(
        travel_scale=1.0 + known.travel,
        travel_scale_sigma=known.travel_sigma,
        yaw_scale=1.0 + known.yaw,
        yaw_scale_sigma=known.yaw_sigma,
        bend_radpm=known.bend_radpm,
        bend_sigma_radpm=known.bend_sigma_radpm,
        lag_s=known.lag_s,
        lag_sigma_s=known.lag_sigma_s,
    )


def slip_part(event: WheelEvent, utc_from_monotonic_ns: int) -> SlipPart:
    """A disagreement of wheels and scans, for a status message."""
    return SlipPart(
        stamp=_utc_s(event.slip.stamp_ns, utc_from_monotonic_ns),
        forward_m=event.slip.forward_m,
        left_m=event.slip.left_m,
        turn_rad=event.slip.turn_rad,
        text=event.text,
    )


def _utc_s(stamp_ns: int, utc_from_monotonic_ns: int) -> float:
    # By an int: ns above 2^53 would be rounded twice.
    return (stamp_ns + utc_from_monotonic_ns) / 1_000_000_000
