from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.calibration.values import Measures
from amr_slam.calibration.wheels import WheelTrack, between
from amr_slam.geometry import Pose2
from amr_slam.odometry import DifferentialDrive
from amr_slam.samples import WheelSample

PERIOD_NS = 20_000_000
MEASURES = Measures(radius_left_m=0.1, radius_right_m=0.11, track_m=0.45, scanners=())
DRIVE = DifferentialDrive(
    radius_left_m=0.1, radius_right_m=0.11, track_m=0.45, max_speed_mps=100.0, max_turn_radps=100.0
)
STEP_RAD = st.floats(-0.3, 0.3)


def counted(steps: list[tuple[float, float]]) -> list[WheelSample]:
    angles = np.vstack([np.zeros(2), np.cumsum(np.array(steps).reshape(-1, 2), axis=0)])
    return [
        WheelSample(stamp_ns=n * PERIOD_NS, left_rad=float(left), right_rad=float(right))
        for n, (left, right) in enumerate(angles)
    ]


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.lists(st.tuples(STEP_RAD, STEP_RAD), min_size=2, max_size=40), st.data())
def test_motions_are_those_of_the_drive_step_by_step(
    steps: list[tuple[float, float]], data: st.DataObject
) -> None:
    samples = counted(steps)
    chosen = sorted(data.draw(st.sets(st.integers(0, len(steps)), min_size=2, max_size=5)))
    track = WheelTrack(samples)
    times_s = track.seconds(np.array([samples[n].stamp_ns for n in chosen]))
    got = track.motions(MEASURES, times_s)
    for row, (first, last) in zip(got, itertools.pairwise(chosen), strict=True):
        pose = Pose2.identity()
        for before, after in itertools.pairwise(samples[first : last + 1]):
            pose = pose @ DRIVE.motion(before, after).delta
        np.testing.assert_allclose(row, pose.as_array(), atol=1e-9)


def test_travel_counts_both_ways_and_breaks_are_known() -> None:
    samples = counted([(0.1, 0.1)] * 5 + [(-0.1, -0.1)] * 5 + [(-0.1, 0.1)] * 5)
    samples = [
        WheelSample(stamp_ns=s.stamp_ns, left_rad=s.left_rad, right_rad=s.right_rad, segment=n > 12)
        for n, s in enumerate(samples)
    ]
    track = WheelTrack(samples)
    times_s = 0.02 * np.array([0, 10, 15])
    way_m, turned_rad = track.travel(MEASURES, times_s)
    np.testing.assert_allclose(way_m, [1.05 * 0.1, 1.05 * 0.05], rtol=1e-9)
    np.testing.assert_allclose(turned_rad[1], 0.5 * (0.1 + 0.11) / 0.45, rtol=1e-9)
    assert track.whole(times_s).tolist() == [True, False]
    assert track.covers(np.array([0.0, 0.1, 0.3]), 0.05).tolist() == [False, True, False]


def test_between_is_the_pose_in_the_frame_of_the_one_before() -> None:
    poses = [Pose2(1.0, 2.0, 3.0), Pose2(0.5, -1.0, -3.0), Pose2(4.0, 0.0, 1.0)]
    got = between(np.array([pose.as_array() for pose in poses]))
    for row, (a, b) in zip(got, itertools.pairwise(poses), strict=True):
        np.testing.assert_allclose(row, (a.inverse() @ b).as_array(), atol=1e-12)
