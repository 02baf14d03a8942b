"""Which wheel is to blame, and for how long that is said."""

from __future__ import annotations

import numpy as np
import pytest

from amr_slam.fusion import Slip
from amr_slam.geometry import Pose2
from amr_slam.odometry import DifferentialDrive, PoseOdometry
from amr_slam.samples import Motion
from amr_slam.wheel_events import KEPT, WheelEvents

S = 1_000_000_000
DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)


def slip(left_m: float, right_m: float, stamp_ns: int = 10 * S) -> Slip:
    """What scans see when the wheels went so much less far than they said."""
    return Slip(
        stamp_ns=stamp_ns,
        since_ns=stamp_ns - 2 * S,
        forward_m=-0.5 * (left_m + right_m),
        left_m=0.0,
        turn_rad=-(right_m - left_m) / 0.5,
    )


def reported(left_m: float, right_m: float) -> Motion:
    twist = [0.5 * (left_m + right_m), 0.0, (right_m - left_m) / 0.5]
    return Motion(
        start_ns=8 * S, end_ns=10 * S, delta=Pose2.exp(twist), covariance=np.zeros((3, 3))
    )


@pytest.mark.parametrize(
    ("said", "error", "way"),
    [
        ("left wheel slips", slip(0.2, 0.0), reported(0.8, 0.6)),
        ("right wheel slips", slip(0.0, 0.3), reported(0.6, 0.9)),
        ("left wheel stuck", slip(-0.3, 0.0), reported(0.0, 0.3)),
        ("wheels slip", slip(-0.6, 0.0), reported(0.0, 0.6)),
        ("wheels slip", slip(0.2, 0.2), reported(0.8, 0.8)),
    ],
)
def test_the_wheel_to_blame(said: str, error: Slip, way: Motion) -> None:
    events = WheelEvents(DRIVE)
    events.note(error, way)
    (one,) = events.newest
    assert one.text.startswith(said)
    assert one.slip is error
    assert "within 2.0 s" in one.text


def test_other_drives_blame_no_wheel() -> None:
    events = WheelEvents(PoseOdometry())
    events.note(slip(0.2, 0.0), reported(0.8, 0.6))
    assert events.newest[0].text.startswith("wheels slip: the robot went -0.10 m, +23 deg")


def test_events_are_told_while_fresh_and_the_last_ones_kept() -> None:
    events = WheelEvents(DRIVE)
    assert events.fault(0, 10.0) is None
    for k in range(8):
        events.note(slip(0.2, 0.0, stamp_ns=k * S), reported(0.8, 0.6))
    events.note(slip(0.9, 0.0, stamp_ns=7 * S), None)  # the same fix, absorbed anew
    assert [one.slip.stamp_ns // S for one in events.newest] == [3, 4, 5, 6, 7]
    assert len(events.newest) == KEPT
    assert events.fault(17 * S, 10.0) is not None
    assert events.fault(18 * S, 10.0) is None


def test_a_leap_goes_on_and_is_told_once() -> None:
    events = WheelEvents(DRIVE)
    for k in range(20):
        stamp_ns = 10 * S + k * 20_000_000
        leap = Slip(
            stamp_ns=stamp_ns, since_ns=stamp_ns - S // 5, forward_m=0.0, left_m=0.0, turn_rad=0.0
        )
        events.note_leap(leap, 10.0)
    (one,) = events.newest
    assert one.text == "wheels slip: their speed leapt within 0.2 s"
