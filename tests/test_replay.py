from __future__ import annotations

import functools
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import lab
from paths import SHARED

from amr_slam.engine import SlamEngine
from amr_slam.evaluation import absolute_trajectory_error
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import DifferentialDrive, Odometry, PoseOdometry, TricycleDrive
from amr_slam.params import SlamParams
from amr_slam.recording import RecordingWriter, Sample, Trajectory, read_log, read_tum
from amr_slam.replay import ReplayResult, replay, spread, thin_scans
from amr_slam.samples import JointSample, OdometrySample, Scan, WheelSample
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    opposite_scanners,
    plan_tour,
)

PARAMS = SlamParams()


def run(
    samples: list[Sample], odometry: Odometry, mountings: dict[str, Mounting]
) -> tuple[ReplayResult, PointMap]:
    """Mapping from nothing."""
    localizer = Localizer(
        LocalizerParams(), FilterParams(), PARAMS.clouds, odometry, mountings, "mapping"
    )
    grown = PointMap(PARAMS.map)
    return replay(samples, localizer, SlamEngine(PARAMS, grown, "mapping")), grown


@functools.cache
def driven(seconds: float = 40.0) -> tuple[list[Sample], Trajectory, dict[str, Mounting]]:
    """The beginning of a tour by slipping wheels, and the truth at each wheel sample."""
    tour = plan_tour(lab(3))
    scanners = opposite_scanners(ScannerModel(sigma_range_m=0.01))
    robot = SimulatedRobot(
        world=lab(3), world_from_map=tour.world_from_map, scanners=scanners, seed=5
    )
    follower = PathFollower(tour.path_in_map_m)
    samples: list[Sample] = []
    stamps, poses = [robot.stamp_ns], [robot.map_from_base.as_array()]
    while robot.stamp_ns < seconds * 1e9:
        samples += robot.advance(*follower.steer(robot.map_from_base))
        stamps.append(robot.stamp_ns)
        poses.append(robot.map_from_base.as_array())
    truth = Trajectory(stamps_ns=np.array(stamps, dtype=np.int64), poses=np.array(poses))
    mountings = {s.name: Mounting(base_from_lidar=s.base_from_lidar) for s in scanners}
    return samples, truth, mountings


def drive() -> DifferentialDrive:
    return DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)


def test_a_simulated_log_comes_out_where_the_robot_was_and_twice_the_same() -> None:
    samples, truth, mountings = driven()
    result, grown = run(samples, drive(), mountings)
    wheels = [sample.stamp_ns for sample in samples if isinstance(sample, WheelSample)]
    # The first sample starts the filter; each gives a pose.
    np.testing.assert_array_equal(result.online.stamps_ns, wheels)
    np.testing.assert_array_equal(result.final.stamps_ns, wheels)
    online = absolute_trajectory_error(result.online, truth, align=False)
    final = absolute_trajectory_error(result.final, truth, align=False)
    assert online.position_m.rms < 0.03
    assert online.heading_deg.rms < 0.5
    assert final.position_m.rms < 0.03
    error = np.hypot(*(result.online.poses - truth.poses)[:, :2].T)
    assert np.mean(error <= result.error95_m) > 0.9
    assert len(result.results) == 20
    assert result.refused == 0
    again, same_map = run(samples, drive(), mountings)
    np.testing.assert_array_equal(again.online.poses, result.online.poses)
    np.testing.assert_array_equal(again.final.poses, result.final.poses)
    np.testing.assert_array_equal(again.error95_m, result.error95_m)
    np.testing.assert_array_equal(same_map.walls.sums, grown.walls.sums)


def test_a_tricycle_comes_out_where_the_robot_was_by_way_of_a_recording(tmp_path: Path) -> None:
    """The same tour as a truck's steered wheel 1.2 m ahead of the axle would have counted it."""
    samples, truth, mountings = driven()
    truck = TricycleDrive(radius_m=0.12, wheel_base_m=1.2, max_turn_radps=3.0)
    file = tmp_path / "truck.mcap"
    with RecordingWriter(file) as writer:
        for sample in as_tricycle(samples, truck):
            writer.write(sample)
    read = list(read_log(file).samples)
    assert {type(sample) for sample in read} == {Scan, JointSample}
    result, _ = run(read, truck, mountings)
    error = absolute_trajectory_error(result.online, truth, align=False)
    assert error.position_m.rms < 0.03
    assert error.heading_deg.rms < 0.5


def as_tricycle(samples: list[Sample], truck: TricycleDrive) -> list[Sample]:
    """Each wheel sample's step rolled and steered by the truck's wheel; scans as they are."""
    told: list[Sample] = []
    rolled_rad = steer_rad = 0.0
    last: WheelSample | None = None
    for sample in samples:
        if not isinstance(sample, WheelSample):
            told.append(sample)
            continue
        if last is not None:
            delta = drive().motion(last, sample).delta
            way = math.hypot(delta.x_m, delta.theta_rad * truck.wheel_base_m)
            wanted_rad = math.atan2(delta.theta_rad * truck.wheel_base_m, delta.x_m)
            turned_rad = math.remainder(wanted_rad - steer_rad, 2.0 * math.pi) if way else 0.0
            # Half a turn of the steering is the other way of rolling: whichever is nearer.
            back = abs(turned_rad) > math.pi / 2
            steer_rad += math.remainder(turned_rad - math.pi, 2 * math.pi) if back else turned_rad
            rolled_rad += (-way if back else way) / truck.radius_m
        last = sample
        angles = (rolled_rad, steer_rad)
        told.append(JointSample(stamp_ns=sample.stamp_ns, names=truck.joints, angles_rad=angles))
    return told


def test_the_online_pose_knows_nothing_of_what_comes_later() -> None:
    samples, _, mountings = driven()
    cut = len(samples) // 2
    whole, _ = run(samples[: cut + 200], drive(), mountings)
    half, _ = run(samples[:cut], drive(), mountings)
    np.testing.assert_array_equal(whole.online.poses[: len(half.online)], half.online.poses)


def scan(scanner: str, stamp_ns: int) -> Scan:
    return Scan(
        scanner=scanner,
        stamp_ns=stamp_ns,
        ranges_m=np.ones(3),
        angle_min_rad=0.0,
        angle_step_rad=0.1,
    )


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    steps=st.lists(st.tuples(st.integers(0, 900), st.sampled_from("ab ")), max_size=40),
    period=st.sampled_from([0.0, 0.5, 2.0]),
)
def test_thinning_keeps_the_wheels_and_spaces_each_scanner(
    steps: list[tuple[int, str]], period: float
) -> None:
    samples: list[Sample] = []
    now = 0
    for step_ms, who in steps:
        now += step_ms * 1_000_000
        if who == " ":
            samples.append(WheelSample(stamp_ns=now, left_rad=0.0, right_rad=0.0))
        else:
            samples.append(scan(who, now))
    kept = list(thin_scans(samples, period))
    assert [s for s in kept if not isinstance(s, Scan)] == [
        s for s in samples if not isinstance(s, Scan)
    ]
    for who in "ab":
        every = [s for s in samples if isinstance(s, Scan) and s.scanner == who]
        chosen = [s for s in kept if isinstance(s, Scan) and s.scanner == who]
        assert chosen[:1] == every[:1]
        assert all(b.stamp_ns - a.stamp_ns >= period * 1e9 for a, b in pairwise(chosen))
        # None is missing: each one left out came too soon after one that was kept.
        for left_out in every:
            before = [s.stamp_ns for s in chosen if s.stamp_ns <= left_out.stamp_ns]
            assert left_out in chosen or left_out.stamp_ns - before[-1] < period * 1e9


def straight(count: int) -> tuple[Trajectory, list[Pose2]]:
    """Wheels that say: along x, 10 cm a sample; and an online trajectory to be replaced."""
    odometry = [Pose2(0.1 * i, 0.0, 0.0) for i in range(count)]
    stamps = np.arange(count, dtype=np.int64) * 100
    poses: Array = np.zeros((count, 3))
    return Trajectory(stamps_ns=stamps, poses=poses), odometry


def test_a_correction_is_spread_evenly_between_its_fixes() -> None:
    online, odometry = straight(21)
    # The wheels ran 10 % short, and 20 cm to the side over the second half.
    fixes = [(0, Pose2(5.0, 0.0, 0.0)), (1000, Pose2(6.1, 0.0, 0.0)), (2000, Pose2(7.1, 0.2, 0.0))]
    final = spread(online, odometry, fixes).poses
    i = np.arange(11)
    np.testing.assert_allclose(final[:11, 0], 5.0 + 0.11 * i, atol=1e-9)
    np.testing.assert_allclose(final[10:, 0], 6.1 + 0.1 * i, atol=1e-9)
    np.testing.assert_allclose(final[10:, 1], 0.02 * i, atol=1e-9)


def test_before_the_first_and_after_the_last_fix_the_wheels_are_hung_on() -> None:
    online, odometry = straight(21)
    fixes = [(500, Pose2(1.0, 1.0, 0.5 * math.pi)), (1000, Pose2(1.0, 1.5, 0.5 * math.pi))]
    final = spread(online, odometry, fixes).poses
    np.testing.assert_allclose(final[:, 0], 1.0, atol=1e-9)
    np.testing.assert_allclose(final[:, 1], 0.5 + 0.1 * np.arange(21), atol=1e-9)
    np.testing.assert_allclose(final[:, 2], 0.5 * math.pi)
    np.testing.assert_array_equal(spread(online, odometry, []).poses, online.poses)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(
    turns=st.lists(st.floats(-0.2, 0.2), min_size=12, max_size=12),
    offset=st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3)),
    at=st.lists(st.integers(0, 11), min_size=1, max_size=5, unique=True).map(sorted),
)
def test_wheels_that_are_right_come_out_as_they_are(
    turns: list[float], offset: tuple[float, float, float], at: list[int]
) -> None:
    """Fixes that agree with the wheels change nothing but the frame."""
    odometry = [Pose2.identity()]
    for turn in turns:
        odometry.append(odometry[-1] @ Pose2.exp([0.1, 0.0, turn]))
    stamps = np.arange(len(odometry), dtype=np.int64) * 10
    online = Trajectory(stamps_ns=stamps, poses=np.zeros((len(odometry), 3)))
    map_from_odom = Pose2.from_array(offset)
    fixes = [(10 * i, map_from_odom @ odometry[i]) for i in at]
    final = spread(online, odometry, fixes)
    for pose, wheels in zip(final.poses, odometry, strict=True):
        expected = map_from_odom @ wheels
        assert Pose2.from_array(pose).distance_to(expected) < 1e-9


LOGS: Path = SHARED / "data" / "logs"


@pytest.mark.skipif(not (LOGS / "seattle.log.gz").exists(), reason="needs the shared logs")
def test_a_real_robot_is_followed_with_a_scan_in_two_seconds() -> None:
    """The first 200 s of a public log, against what its owners made of all of it."""
    log = read_log(LOGS / "seattle.log.gz")
    begin_ns = log.samples[0].stamp_ns
    samples = [
        sample
        for sample in thin_scans(log.samples, 2.0)
        if sample.stamp_ns - begin_ns < 200_000_000_000
    ]
    names = {sample.scanner for sample in samples if isinstance(sample, Scan)}
    mountings = dict.fromkeys(names, Mounting(base_from_lidar=Pose2.identity()))
    assert any(isinstance(sample, OdometrySample) for sample in samples)
    result, grown = run(samples, PoseOdometry(), mountings)
    reference = read_tum(LOGS / "seattle.corrected.tum")
    error = absolute_trajectory_error(result.final, reference, align=True)
    assert error.matched > 40
    assert error.position_m.rms < 0.25
    assert error.heading_deg.median < 1.5
    assert len(grown.path) > 20
