"""What one could do instead: the fused pose's rivals on the same wheels and fixes."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from amr_slam.fusion import CalibrationParams, FilterParams, PoseFilter
from amr_slam.geometry import Array, Pose2
from amr_slam.odometry import Odometry
from amr_slam.samples import OdometrySample, SlamPose, WheelSample

PRODUCT: Final = "this product"
WHEELS: Final = "wheels alone"
HELD: Final = "SLAM pose held"
UNDELAYED: Final = "filter, fixes taken as of now"
METHODS: Final = (PRODUCT, UNDELAYED, HELD, WHEELS)

_TEXTBOOK: Final = FilterParams(
    fix_inflation=2.0,
    map_error_m=0.0,
    map_error_rad=0.0,
    calibration=CalibrationParams(learn=False),
)
Wheels = Sequence[WheelSample | OdometrySample]
Arrivals = Sequence[tuple[int, SlamPose]]


def wheels_alone(wheels: Wheels, odometry: Odometry, start: Pose2) -> Iterator[Pose2]:
    """Dead reckoning from ``start``; one pose a sample."""
    pose = start
    yield pose
    for before, after in itertools.pairwise(wheels):
        pose = pose @ odometry.motion(before, after).delta
        yield pose


def held(wheels: Wheels, fixes: Arrivals, start: Pose2) -> Iterator[Pose2]:
    """The newest fix that has arrived; one pose a wheel sample."""
    waiting, pose = list(fixes), start
    for sample in wheels:
        while waiting and waiting[0][0] <= sample.stamp_ns:
            pose = waiting.pop(0)[1].map_from_base
        yield pose


def undelayed(
    wheels: Wheels, fixes: Arrivals, odometry: Odometry, start: Pose2, covariance: Array
) -> Iterator[Pose2]:
    """A textbook filter of x, y and theta that takes each fix for the pose at its arrival; one
    pose a wheel sample. A fix that it refuses three times running is jumped to."""
    fused = PoseFilter(_TEXTBOOK, wheels[0].stamp_ns, start, covariance)
    waiting, refused = list(fixes), 0
    yield fused.map_from_base
    for before, after in itertools.pairwise(wheels):
        fused.predict(odometry.motion(before, after))
        while waiting and waiting[0][0] <= after.stamp_ns:
            fix = replace(waiting.pop(0)[1], stamp_ns=after.stamp_ns)
            refused = refused + 1 if fused.correct(fix).value == "gated" else 0
            if refused == 3:
                fused.reset(fix.stamp_ns, fix.map_from_base, fix.covariance)
        yield fused.map_from_base
