from __future__ import annotations

import math
import os
import subprocess
import sys
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import REPO

from amr_slam.geometry import Array, Pose2
from amr_slam.recording import read_log, read_tum
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation import (
    PERSON_RADIUS_M,
    ClearanceGrid,
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Tour,
    Vehicle,
    World,
    cast,
    laboratory,
    opposite_scanners,
    plan_tour,
    take_scan,
)

fixed = settings(derandomize=True, deadline=None, max_examples=60)
EXACT = ScannerModel(quantum_m=0.0)
ROOM = np.array([[0, 0, 8, 0], [8, 0, 8, 6], [8, 6, 0, 6], [0, 6, 0, 0.0]])


def room() -> World:
    return World(seed=0, outline_m=ROOM[:, :2], segments_m=ROOM, table_tops_m=np.empty((0, 4)))


def area(polygon: Array) -> float:
    x, y = polygon.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


@fixed
@given(x=st.floats(0.1, 7.9), y=st.floats(0.1, 5.9), angle=st.floats(-3.2, 3.2))
def test_a_beam_in_a_box_meets_the_nearest_wall(x: float, y: float, angle: float) -> None:
    c, s = math.cos(angle), math.sin(angle)
    to_x = (8 - x) / c if c > 1e-12 else -x / c if c < -1e-12 else math.inf
    to_y = (6 - y) / s if s > 1e-12 else -y / s if s < -1e-12 else math.inf
    found = cast(np.array([[x, y]]), np.array([angle]), ROOM)
    assert found[0] == pytest.approx(min(to_x, to_y), rel=1e-9)


@fixed
@given(
    distance=st.floats(0.5, 20.0),
    radius=st.floats(0.05, 0.4),
    bearing=st.floats(-3.1, 3.1),
    off=st.floats(-0.5, 0.5),
)
def test_a_beam_meets_a_circle_where_it_should(
    distance: float, radius: float, bearing: float, off: float
) -> None:
    """The far beam passes the centre by ``distance * sin(off)``."""
    origin = np.array([[1.0, 2.0]])
    centre = origin + distance * np.array([[math.cos(bearing), math.sin(bearing)]])
    none = np.empty((0, 4))
    found = cast(origin, np.array([bearing + off]), none, centre[None], radius)[0]
    aside = distance * math.sin(abs(off))
    if aside >= radius:
        assert found == math.inf or aside == pytest.approx(radius)
    else:
        expected = distance * math.cos(off) - math.sqrt(radius**2 - aside**2)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert cast(origin, np.array([bearing + math.pi]), none, centre[None], radius)[0] == math.inf


@pytest.mark.parametrize("seed", range(10))
def test_laboratories_have_what_the_paper_shows(seed: int) -> None:
    world = laboratory(seed)
    assert area(world.outline_m) == pytest.approx(200.0)
    assert len(world.outline_m) >= 12  # alcoves
    assert len(world.segments_m) - len(world.outline_m) >= 40  # machines, legs, pillars
    assert len(world.table_tops_m) >= 4
    again = laboratory(seed)
    np.testing.assert_array_equal(world.segments_m, again.segments_m)
    other = laboratory(seed + 1)
    assert world.segments_m.shape != other.segments_m.shape or np.any(
        world.segments_m != other.segments_m
    )


def test_clearance_knows_inside_from_outside() -> None:
    box = np.array([[3, 2, 5, 2], [5, 2, 5, 4], [5, 4, 3, 4], [3, 4, 3, 2.0]])
    top = box + np.array([3, 0, 3, 0]) * 0.8
    points = np.array([[1.0, 1.5], [4.0, 3.0], [9.0, 3.0], [2.5, 3.0], [6.0, 3.0]])
    with_box = replace(room(), segments_m=np.concatenate([ROOM, box]))
    np.testing.assert_allclose(with_box.clearance(points), [1.0, -1.0, -1.0, 0.5, 1.0])
    with_table = replace(room(), table_tops_m=top)
    assert with_table.clearance(points)[4] < 0.0
    grid = ClearanceGrid.of(with_box)
    inside = points[[0, 1, 3, 4]]
    np.testing.assert_allclose(grid.at(inside), with_box.clearance(inside), atol=0.08)
    assert grid.at(points[2:3])[0] == -math.inf


def test_a_mounted_scanner_sees_the_walls_where_they_are() -> None:
    model = replace(EXACT, base_from_lidar=Pose2(0.3, 0.2, 0.7))
    world_from_base = Pose2(3.0, 2.0, 1.1)
    scan = take_scan(model, room(), world_from_base, np.random.default_rng(0))
    assert scan.ranges_m.shape == (541,)
    assert scan.angles_rad[270] == pytest.approx(0.0)
    polar = scan.ranges_m * np.array([np.cos(scan.angles_rad), np.sin(scan.angles_rad)])
    points = world_from_base @ (model.base_from_lidar @ polar.T)
    assert np.abs(room().clearance(points)).max() < 1e-9


def test_ranges_are_rounded_and_cut() -> None:
    model = ScannerModel(range_max_m=4.0)
    scan = take_scan(model, room(), Pose2(2.0, 3.0, 0.0), np.random.default_rng(0))
    assert np.isposinf(scan.ranges_m).any()
    near = scan.ranges_m[np.isfinite(scan.ranges_m)]
    assert near.max() < 4.0
    np.testing.assert_allclose(near * 100, np.round(near * 100), atol=1e-9)


def test_xy_noise_is_the_same_in_all_directions() -> None:
    """Points of a wall seen at a slant scatter by sigma across the wall, whatever the slant."""
    wall = np.array([[-100.0, 5.0, 100.0, 5.0]])
    world = World(seed=0, outline_m=wall[:, :2], segments_m=wall, table_tops_m=np.empty((0, 4)))
    noisy = replace(EXACT, sigma_xy_m=0.1, range_max_m=1e3, sweep_s=0.0)
    rng = np.random.default_rng(3)
    for slant_rad in (0.0, 0.6, 1.1):
        off = []
        for _ in range(40):
            scan = take_scan(noisy, world, Pose2(0.0, 0.0, 0.5 * math.pi), rng)
            looks = np.abs(scan.angles_rad - slant_rad) < 0.05
            off.append(scan.ranges_m[looks] * np.cos(scan.angles_rad[looks]) - 5.0)
        errors = np.concatenate(off)
        assert np.std(errors) == pytest.approx(0.1, rel=0.1)
        assert abs(np.mean(errors)) < 0.02


def test_range_noise_lies_along_the_beam() -> None:
    noisy = replace(EXACT, sigma_range_m=0.02)
    rng = np.random.default_rng(1)
    clean = take_scan(EXACT, room(), Pose2(4.0, 3.0, 0.3), rng).ranges_m
    errors = [
        take_scan(noisy, room(), Pose2(4.0, 3.0, 0.3), rng).ranges_m - clean for _ in range(20)
    ]
    assert np.std(errors) == pytest.approx(0.02, rel=0.05)


def robot_in_room(**changes: object) -> SimulatedRobot:
    arguments: dict[str, object] = {
        "world": room(),
        "world_from_map": Pose2(2.0, 3.0, 0.5),
        "scanners": (EXACT,),
        "vehicle": Vehicle(slip_m=0.0),
        "scan_period_s": 0.1,
    }
    return SimulatedRobot(**(arguments | changes))  # type: ignore[arg-type]  # test shorthand


def test_a_sweep_of_a_moving_robot_is_bent_as_its_stamps_say() -> None:
    """Each beam, seen from the true pose of its own time, ends on a wall; from one pose not."""
    robot = robot_in_room(scanners=(replace(EXACT, sweep_s=0.08, phase_s=0.005),))
    times, truth = [robot.stamp_ns], [robot.map_from_base.as_array()]
    scan = None
    for _ in range(100):
        samples = robot.advance(0.4, 0.7)
        times.append(robot.stamp_ns)
        truth.append(robot.map_from_base.as_array())
        scan = next((s for s in samples if isinstance(s, Scan)), scan)
    assert isinstance(scan, Scan)
    beams = scan.stamp_ns + 1e9 * scan.sweep_s * np.linspace(0.0, 1.0, 541)
    x, y, theta = (np.interp(beams, times, axis) for axis in np.array(truth).T)
    angles = scan.angles_rad + theta
    ends = np.column_stack([x + scan.ranges_m * np.cos(angles), y + scan.ranges_m * np.sin(angles)])
    assert np.abs(room().clearance(robot.world_from_map @ ends)).max() < 1e-3
    angles = scan.angles_rad + theta[0]
    rigid = np.column_stack(
        [x[0] + scan.ranges_m * np.cos(angles), y[0] + scan.ranges_m * np.sin(angles)]
    )
    assert np.abs(room().clearance(robot.world_from_map @ rigid)).max() > 0.05


@settings(fixed, max_examples=20)
@given(commands=st.lists(st.tuples(st.floats(-0.3, 0.4), st.floats(-0.8, 0.8)), max_size=8))
def test_wheel_counts_add_up_to_the_truth(commands: list[tuple[float, float]]) -> None:
    vehicle = Vehicle(
        slip_m=0.0, left_radius_error=0.02, right_radius_error=-0.01, track_error=0.05
    )
    robot = robot_in_room(vehicle=vehicle, scanners=())
    pose, last = Pose2.identity(), np.zeros(2)
    track_m = vehicle.track_m * 1.05
    for v, omega in commands:
        for _ in range(10):
            sample = robot.advance(v, omega)[-1]
            assert isinstance(sample, WheelSample)
            assert sample.stamp_ns == robot.stamp_ns
            wheels = np.array([sample.left_rad, sample.right_rad])
            left, right = (wheels - last) * vehicle.wheel_radius_m * np.array([1.02, 0.99])
            pose = pose @ Pose2.exp([0.5 * (left + right), 0.0, (right - left) / track_m])
            last = wheels
    assert pose.distance_to(robot.map_from_base) < 1e-3
    assert abs((pose.inverse() @ robot.map_from_base).theta_rad) < 1e-3


def test_stamps_and_speeds_keep_their_limits() -> None:
    robot = robot_in_room(
        scanners=opposite_scanners(EXACT), scan_period_s=0.1, start_ns=5_000_000_000
    )
    samples = [sample for _ in range(50) for sample in robot.advance(0.3, 0.0)]
    wheels = [s.stamp_ns for s in samples if isinstance(s, WheelSample)]
    assert wheels == [5_000_000_000 + 20_000_000 * i for i in range(51)]
    for name, phase_ns in (("front", 0), ("rear", 13_000_000)):
        scans = [s for s in samples if isinstance(s, Scan) and s.scanner == name]
        assert [s.stamp_ns for s in scans] == [
            5_000_000_000 + phase_ns + 100_000_000 * i for i in range(10)
        ]
        assert [s.seq for s in scans] == list(range(10))
    way = robot.map_from_base.x_m  # 0.5 m/s2 up to 0.3 m/s, then on for the rest of 1 s
    assert way == pytest.approx(0.3 - 0.5 * 0.3 * 0.6, abs=0.01)


def test_the_robot_stops_at_walls_and_can_leave_them() -> None:
    robot = robot_in_room(scanners=(), world_from_map=Pose2(6.5, 3.0, 0.0))
    for _ in range(400):
        robot.advance(0.4, 0.0)
    clearance = room().clearance(robot.world_from_base.translation[None])[0]
    assert 0.35 <= clearance < 0.37
    assert robot.bumps > 0
    for _ in range(100):
        robot.advance(-0.3, 0.0)
    assert robot.world_from_base.x_m < 7.3


def test_a_start_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        robot_in_room(world_from_map=Pose2(0.2, 3.0, 0.0))
    with pytest.raises(ValueError, match="sweeps"):
        robot_in_room(scanners=(replace(EXACT, sweep_s=0.5),))


def drive(
    robot: SimulatedRobot, tour: Tour, *, delay: int = 0, noise_m: float = 0.0
) -> tuple[Array, float]:
    """(n, 2) positions of one round, and the least distance to anybody. The follower gets poses
    ``delay`` periods old and off by ``noise_m``."""
    follower = PathFollower(tour.path_in_map_m)
    rng = np.random.default_rng(0)
    seen: deque[Pose2] = deque([robot.map_from_base], maxlen=delay + 1)
    positions, nearest = [robot.world_from_base.translation], math.inf
    while follower.laps < 1.0:
        robot.advance(*follower.steer(seen[0] @ Pose2.exp(rng.normal(0.0, noise_m, 3))))
        seen.append(robot.map_from_base)
        positions.append(robot.world_from_base.translation)
        gaps = np.hypot(*(robot.people_m - positions[-1]).T)
        nearest = min(nearest, float(gaps.min(initial=math.inf)))
        assert robot.stamp_ns < 600e9, "stuck"
    return np.array(positions), nearest


@pytest.mark.parametrize("seed", range(10))
def test_tours_are_free_of_collisions_and_show_the_room(seed: int) -> None:
    world = laboratory(seed)
    tour = plan_tour(world)
    assert world.clearance(np.array(tour.path_m)).min() > 0.45
    np.testing.assert_allclose(tour.path_in_map_m[0], [0.0, 0.0], atol=1e-9)
    robot = SimulatedRobot(
        world=world,
        world_from_map=tour.world_from_map,
        scanners=(),
        people=2 if seed < 4 else 0,
        seed=seed,
    )
    positions, nearest = drive(robot, tour, delay=3, noise_m=0.02 if seed % 2 else 0.0)
    assert robot.bumps == 0
    assert world.clearance(positions).min() > 0.4
    assert nearest > 0.35 + PERSON_RADIUS_M
    assert 140e9 < robot.stamp_ns < 400e9
    assert seen_share(world, positions[::100]) > 0.85


def seen_share(world: World, positions: Array) -> float:
    """Share of the passable cells that a beam from one of the positions crosses."""
    grid = ClearanceGrid.of(world)
    angles = np.radians(np.arange(0.0, 360.0, 0.5))
    seen = np.zeros(grid.clearance_m.shape, dtype=np.bool_)
    for position in positions:
        ranges = cast(np.broadcast_to(position, (len(angles), 2)), angles, world.segments_m)
        steps = np.arange(0.0, 12.0, 0.1)
        ends = position + steps[:, None, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        cells = ends[steps[:, None] < ranges]
        column, row = np.rint((cells - grid.origin_m) / grid.cell_m).astype(np.int64).T
        seen[row, column] = True
    passable = grid.clearance_m > 0.35
    return float(np.mean(seen[passable]))


def test_a_robot_that_is_carried_sees_the_new_place_and_counts_nothing() -> None:
    world = laboratory(3)
    tour = plan_tour(world)
    robot = SimulatedRobot(
        world=world, world_from_map=tour.world_from_map, scanners=opposite_scanners(ScannerModel()),
        scan_period_s=0.1,
    )  # fmt: skip
    follower = PathFollower(tour.path_in_map_m)
    before = [s for s in robot.advance(0.0, 0.0) if isinstance(s, WheelSample)][-1]
    there = robot.world_from_map @ follower.skip(8.0)
    robot.carry(there)
    assert robot.world_from_base == there
    samples = [s for _ in range(10) for s in robot.advance(0.0, 0.0)]
    wheels = [s for s in samples if isinstance(s, WheelSample)]
    assert {(s.left_rad, s.right_rad) for s in wheels} == {(before.left_rad, before.right_rad)}
    fresh = SimulatedRobot(
        world=world, world_from_map=there, scanners=opposite_scanners(ScannerModel()),
        scan_period_s=0.1,
    )  # fmt: skip
    seen = [s for _ in range(10) for s in fresh.advance(0.0, 0.0) if isinstance(s, Scan)]
    carried = [s for s in samples if isinstance(s, Scan)]
    np.testing.assert_allclose(carried[-1].ranges_m, seen[-1].ranges_m, atol=0.011)
    # It drives on along its way from there.
    v_mps, omega_radps = follower.steer(robot.map_from_base)
    assert v_mps > 0.1
    assert abs(omega_radps) < 0.8
    with pytest.raises(ValueError, match="does not fit"):
        robot.carry(Pose2(1e3, 1e3, 0.0))


def test_same_seed_same_samples() -> None:
    def samples(seed: int) -> list[str]:
        world = laboratory(1)
        tour = plan_tour(world)
        robot = SimulatedRobot(
            world=world,
            world_from_map=tour.world_from_map,
            scanners=opposite_scanners(ScannerModel(sigma_xy_m=0.1)),
            people=3,
            seed=seed,
            scan_period_s=0.5,
        )
        follower = PathFollower(tour.path_in_map_m)
        steps = (robot.advance(*follower.steer(robot.map_from_base)) for _ in range(150))
        return [
            repr(s.ranges_m.tobytes()) if isinstance(s, Scan) else repr(s)
            for step in steps
            for s in step
        ]

    assert samples(5) == samples(5)
    assert samples(5) != samples(6)


def test_people_are_seen_and_never_met() -> None:
    """A robot that drives to and fro among many people: it waits, and no one is touched."""
    robot = robot_in_room(people=4, seed=2, scan_period_s=1.0, scanners=(EXACT,))
    shorter = 0
    for i in range(1500):
        for sample in robot.advance(0.4 if (i // 150) % 2 == 0 else -0.4, 0.3):
            if isinstance(sample, Scan):
                robot_pose = robot.world_from_base
                empty = take_scan(EXACT, room(), robot_pose, np.random.default_rng(0))
                shorter += int(np.sum(sample.ranges_m < empty.ranges_m - 0.3))
        gaps = np.hypot(*(robot.people_m - robot.world_from_base.translation).T)
        assert gaps.min() >= 0.35 + PERSON_RADIUS_M
        assert room().clearance(robot.people_m).min() > PERSON_RADIUS_M
    assert shorter > 200


def test_the_protective_field_stops_the_robot_before_a_person(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = robot_in_room(people=1, scanners=())
    person = robot.people_m[0]
    monkeypatch.setattr(robot._people, "walk", lambda *_: None)
    for _ in range(600):
        to_person = robot.world_from_base.inverse() @ person[None]
        bearing_rad = math.atan2(to_person[0, 1], to_person[0, 0])
        robot.advance(0.3 if abs(bearing_rad) < 0.1 else 0.0, 2.0 * bearing_rad)
    gap_m = robot.world_from_base.distance_to(Pose2(person[0], person[1], 0.0))
    assert robot.bumps == 0
    assert 0.1 < gap_m - 0.35 - PERSON_RADIUS_M < 0.2


def test_the_tool_writes_a_recording_and_its_truth(tmp_path: Path) -> None:
    outputs = []
    for name in ("a", "b"):
        out, truth = tmp_path / f"{name}.mcap", tmp_path / f"{name}.tum"
        command = [sys.executable, "tools/simulate.py", "--seed", "3", "--duration", "6"]
        command += ["--noise-xy", "0.1", "--odometry-error", "0.01", "--people", "1"]
        command += ["--out", str(out), "--truth", str(truth)]
        environment = os.environ | {"PYTHONHASHSEED": name.encode().hex()[:2]}
        done = subprocess.run(command, cwd=REPO, env=environment, check=True, capture_output=True)
        assert b"6.0 s, 6 scans, 0 bumps" in done.stdout
        outputs.append((out.read_bytes(), truth.read_bytes()))
    assert outputs[0] == outputs[1]
    log = read_log(tmp_path / "a.mcap")
    reference = read_tum(tmp_path / "a.tum")
    assert log.truth is not None
    np.testing.assert_array_equal(log.truth.stamps_ns, reference.stamps_ns)
    np.testing.assert_allclose(log.truth.poses, reference.poses, atol=1e-6)
    np.testing.assert_array_equal(reference.poses[0], np.zeros(3))
    assert {type(sample) for sample in log.samples} == {Scan, WheelSample}
