from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from paths import REPO

from amr_drivers.can_odometry import driver as can_driver
from amr_drivers.can_odometry.settings import WheelSettings
from amr_drivers.emulators.robot import EmulatedRobot, RobotModel, RobotProcess
from amr_drivers.emulators.robot.process import _Commands
from amr_drivers.errors import LinkLost
from amr_drivers.sick_s300 import driver as s300_driver
from amr_slam.evaluation import poses_at
from amr_slam.geometry import Pose2
from amr_slam.recording import Trajectory
from amr_slam.samples import OdometrySource, Scan, Scanner, WheelSample
from amr_slam.simulation import World, cast, laboratory, opposite_scanners
from amr_slam.simulation.scanner import ScannerModel

DBC = str(REPO / "config/wheels.dbc")
PORTS = ("can", "scanner-front", "scanner-rear")
SEED = 7
DEADLINE_S = 20.0


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[RobotProcess]:
    with RobotProcess(tmp_path, DBC, SEED) as robot:
        yield robot


def drive_until(
    robot: RobotProcess, condition: Callable[[], bool], command: tuple[float, float] = (0.3, 0.3)
) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s
        robot.drive(*command)
        time.sleep(0.02)


def test_real_drivers_measure_what_the_truth_says(tmp_path: Path, robot: RobotProcess) -> None:
    wheels = can_driver.open_odometry(
        can_driver.Settings(
            interface="slcan",
            channel=str(tmp_path / "can"),
            dbc=DBC,
            left=WheelSettings(signal="LeftCount"),
            right=WheelSettings(signal="RightCount"),
            sequence_signal="Sequence",
        )
    )
    scanners = {
        name: s300_driver.open_scanner(
            name, s300_driver.Settings(port=str(tmp_path / f"scanner-{name}"))
        )
        for name in ("front", "rear")
    }
    counts: list[WheelSample] = []
    scans: list[Scan] = []

    def listen() -> bool:
        while (sample := wheels.read(0.0)) is not None:
            assert isinstance(sample, WheelSample)
            counts.append(sample)
        read = (scanner.read(0.0) for scanner in scanners.values())
        scans.extend(scan for scan in read if scan is not None)
        return len(counts) >= 100 and {scan.scanner for scan in scans[4:]} == set(scanners)

    drive_until(robot, listen)
    # The truth of the newest scan, too.
    newest_ns = max(counts[-1].stamp_ns, *(scan.mid_stamp_ns for scan in scans)) + 100_000_000
    drive_until(robot, lambda: int(robot.truth().stamps_ns[-1]) > newest_ns)
    devices: tuple[Scanner | OdometrySource, ...] = (wheels, *scanners.values())
    for device in devices:
        assert device.status()[0] == 0
        device.close()
    truth = robot.truth()
    _assert_wheels_agree(counts, truth)
    world_from_map, world = RobotModel(seed=SEED).tour().world_from_map, laboratory(SEED)
    # The very first sweep began before the first step was told; while a late processor makes the
    # world stand still for long, nothing is told of it.
    where, known = poses_at(truth, np.array([scan.mid_stamp_ns for scan in scans]))
    judged = [(scan, pose) for scan, pose, ok in zip(scans, where, known, strict=True) if ok]
    assert {scan.scanner for scan, _ in judged} == set(scanners)
    for scan, pose in judged:
        if scan.stamp_ns > truth.stamps_ns[0]:
            _assert_scan_agrees(scan, Pose2.from_array(pose), world_from_map, world)


def _assert_wheels_agree(counts: list[WheelSample], truth: Trajectory) -> None:
    model = RobotModel(seed=SEED)
    assert {sample.segment for sample in counts} == {0}
    where, known = poses_at(truth, np.array([sample.stamp_ns for sample in counts]))
    counts = [sample for sample, ok in zip(counts, known, strict=True) if ok]
    assert len(counts) >= 50
    where = where[known]
    radii_m = 0.1 * (1.0 + np.array([model.left_radius_error, model.right_radius_error]))
    ways_m = radii_m * [
        counts[-1].left_rad - counts[0].left_rad,
        counts[-1].right_rad - counts[0].right_rad,
    ]
    way_m = float(np.hypot(*np.diff(where[:, :2], axis=0).T).sum())
    assert way_m > 0.2
    # 1 % and 10 ms of driving: slip, counting steps, and a scheduler late by so much.
    assert ways_m.mean() == pytest.approx(way_m, rel=0.01, abs=0.003)
    turn_rad = float(np.unwrap(where[:, 2])[-1] - where[0, 2])
    track_m = 0.5 * (1.0 + model.track_error)
    assert (ways_m[1] - ways_m[0]) / track_m == pytest.approx(turn_rad, abs=0.02)


def _assert_scan_agrees(
    scan: Scan, map_from_base: Pose2, world_from_map: Pose2, world: World
) -> None:
    """Each beam against the walls, from where the scanner really was; people may stand before."""
    mountings = {m.name: m.base_from_lidar for m in opposite_scanners(ScannerModel())}
    lidar = world_from_map @ map_from_base @ mountings[scan.scanner]
    expected = cast(
        np.broadcast_to(lidar.translation, (len(scan.ranges_m), 2)),
        lidar.theta_rad + scan.angles_rad,
        world.segments_m,
    )
    errors_m = np.abs(scan.ranges_m - expected)
    assert np.median(errors_m) < 0.02
    assert np.mean(errors_m < 0.06) > 0.75


def test_without_commands_the_robot_stands(robot: RobotProcess) -> None:
    drive_until(robot, lambda: robot.truth().poses[-1, 0] > 0.1, (0.3, 0.0))
    # Commands end: it brakes within their time-out and the way of a deceleration of 0.5 m/s2.
    passed = len(robot.truth()) + 75
    deadline_s = time.monotonic() + DEADLINE_S
    while len(robot.truth()) < passed:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    poses = robot.truth().poses
    np.testing.assert_array_equal(poses[-1], poses[-5])
    assert robot.paused_s() >= 0.0


def test_the_robot_leaves_nothing_behind(tmp_path: Path) -> None:
    robot = RobotProcess(tmp_path, DBC, SEED)
    assert sorted(os.listdir(tmp_path)) == sorted(PORTS)
    robot.close()
    robot.close()
    assert os.listdir(tmp_path) == []
    with pytest.raises(LinkLost, match="has ended"):
        robot.drive(0.0, 0.0)


def test_an_impossible_command_ends_the_robot(tmp_path: Path, robot: RobotProcess) -> None:
    with pytest.raises(LinkLost):
        drive_until(robot, lambda: False, (math.nan, 0.0))
    robot.close()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("line", [b"0 4\n", b"-9 0\n", b"1\n", b"1 2 3\n", b"a b\n", b"\xff 0\n"])
def test_what_is_no_command_is_refused(line: bytes) -> None:
    reader, writer = os.pipe()
    os.write(writer, line)
    with pytest.raises(ValueError, match=r"."):
        _Commands(reader).newest()
    os.close(reader)
    os.close(writer)


def test_only_the_newest_whole_command_counts() -> None:
    reader, writer = os.pipe()
    commands = _Commands(reader)
    assert commands.newest() == (0.0, 0.0)
    os.write(writer, b"0.1 0.2\n0.3 0.4\n0.5 ")
    assert commands.newest() == (0.3, 0.4)
    os.write(writer, b"0.6\n")
    assert commands.newest() == (0.5, 0.6)
    os.close(writer)
    assert commands.newest() is None
    os.close(reader)


def test_a_robot_that_cannot_start_says_so(tmp_path: Path) -> None:
    with pytest.raises(LinkLost, match="did not start"):
        RobotProcess(tmp_path, str(tmp_path / "none.dbc"), SEED)


def test_a_late_processor_pauses_the_world(tmp_path: Path) -> None:
    with EmulatedRobot(tmp_path, DBC, RobotModel(seed=SEED, people=0)) as robot:
        stamps_ns = []
        for pause_s in (0.0, 0.0, 0.2, 0.0, 0.0):
            time.sleep(pause_s)
            stamps_ns.append(robot.step(0.3, 0.0)[0])
            # Never told before it is true.
            assert time.monotonic_ns() >= stamps_ns[-1]
        steps_ns = np.diff(stamps_ns)
        assert (steps_ns >= 20_000_000).all()
        assert steps_ns[1] >= 200_000_000
        assert steps_ns[-1] < 200_000_000 or steps_ns[-2] < 200_000_000
