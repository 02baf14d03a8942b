from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation import (
    SCANNERS,
    ClearanceGrid,
    ScannerModel,
    SimulatedRobot,
    World,
    cast,
    corridors,
    hall,
    laboratory,
    odd,
    offices,
    plan_tour,
    symmetric,
    take_scan,
)
from amr_slam.simulation.casting import to_all_segments
from amr_slam.simulation.shapes import distance_to_segments, odd_crossings, polygon_area
from amr_slam.simulation.tour import PathFollower

KINDS = {f.__name__: f for f in (hall, offices, corridors, symmetric, odd)}
CASES = [
    (kind, seed, area)
    for kind in KINDS
    for seed, area in ((0, 50.0), (1, 200.0), (2, 320.0), (3, 1000.0))
]
HULL_M = 0.42  # a robot of 0.35 m with 7 cm beside it


@functools.cache
def world(kind: str, seed: int, area_m2: float) -> World:
    make: Callable[[int, float], World] = KINDS[kind]
    return make(seed, area_m2)


@functools.cache
def grid(kind: str, seed: int, area_m2: float) -> ClearanceGrid:
    return ClearanceGrid.of(world(kind, seed, area_m2))


def directions(angles_rad: Array) -> Array:
    return np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])


@settings(derandomize=True, deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 400), size_m=st.floats(1.0, 150.0))
def test_beams_through_cells_meet_what_all_walls_say(seed: int, count: int, size_m: float) -> None:
    rng = np.random.default_rng(seed)
    starts, along = rng.uniform(0.0, size_m, (count, 2)), rng.normal(0.0, 0.1 * size_m, (count, 2))
    along[rng.random((count, 2)) < 0.3] = 0.0  # upright, level, and none at all
    walls = np.hstack([starts, starts + along])
    origins = rng.uniform(-0.3 * size_m, 1.3 * size_m, (60, 2))
    angles = rng.uniform(-np.pi, np.pi, 60)
    angles[:4] = [0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi]
    origins[4:8] = starts[0]
    expected = to_all_segments(origins, directions(angles), walls)
    np.testing.assert_array_equal(cast(origins, angles, walls), expected)


def test_clearance_by_tiles_is_that_of_all_walls() -> None:
    shop = world("hall", 3, 1000.0)
    low, high = shop.outline_m.min(axis=0), shop.outline_m.max(axis=0)
    points = np.random.default_rng(0).uniform(low - 3.0, high + 3.0, (3000, 2))
    edges = np.concatenate([shop.segments_m, shop.table_tops_m])
    free = odd_crossings(points, shop.segments_m) & ~odd_crossings(points, shop.table_tops_m)
    distance = distance_to_segments(points, edges)
    np.testing.assert_array_equal(shop.clearance(points), np.where(free, distance, -distance))


@pytest.mark.parametrize(("kind", "seed", "area_m2"), CASES)
def test_worlds_have_the_wanted_floor(kind: str, seed: int, area_m2: float) -> None:
    found = polygon_area(world(kind, seed, area_m2).outline_m)
    if kind == "corridors":  # the blocks between them are no floor
        free = grid(kind, seed, area_m2).clearance_m > 0.0
        found = 0.01 * float(free.sum())
    assert found == pytest.approx(area_m2, rel=0.15)


@pytest.mark.parametrize(("kind", "seed", "area_m2"), CASES)
def test_worlds_are_closed(kind: str, seed: int, area_m2: float) -> None:
    """No beam from a free place leaves the room, and what it meets is a wall."""
    room, clearance = world(kind, seed, area_m2), grid(kind, seed, area_m2)
    free = np.flatnonzero(clearance.clearance_m.ravel() > 0.1)
    cells = np.random.default_rng(0).choice(free, 300)
    origins = np.array([clearance.centre(int(cell)) for cell in cells])
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, 300)
    ranges = cast(origins, angles, room.segments_m)
    assert np.isfinite(ranges).all()
    short = origins + (ranges - 1e-3)[:, None] * directions(angles)
    inside = odd_crossings(short, room.segments_m)
    assert np.mean(inside) > 0.99  # a hit within 1 mm of a corner may end behind it


@pytest.mark.parametrize(("kind", "seed", "area_m2"), CASES)
def test_a_tour_leads_near_to_most_of_the_floor(kind: str, seed: int, area_m2: float) -> None:
    room, clearance = world(kind, seed, area_m2), grid(kind, seed, area_m2)
    path = plan_tour(room).path_m
    steps = np.hypot(*(np.roll(path, -1, axis=0) - path).T)
    assert steps.max() < 0.08
    assert room.clearance(np.array(path)).min() > 0.35
    fits = clearance.clearance_m >= HULL_M
    parts, _ = ndimage.label(fits, structure=np.ones((3, 3)))
    column, row = np.rint((path - clearance.origin_m) / clearance.cell_m).astype(np.int64).T
    here = np.bincount(parts[row, column]).argmax()
    assert np.mean(parts[fits] == here) > 0.9
    rows, columns = np.nonzero(parts == here)
    places = clearance.origin_m + clearance.cell_m * np.column_stack([columns, rows])
    some = np.random.default_rng(0).choice(len(places), 400)
    away = np.min(np.hypot(*(places[some][:, None] - path[::10]).transpose(2, 0, 1)), axis=1)
    # A short round may only look into the corners of an open room.
    assert np.quantile(away, 0.95) < (10.0 if area_m2 <= 250.0 else 5.0)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_world(kind: str) -> None:
    one, again = world(kind, 1, 200.0), KINDS[kind](1, 200.0)
    np.testing.assert_array_equal(one.segments_m, again.segments_m)
    np.testing.assert_array_equal(one.table_tops_m, again.table_tops_m)
    other = KINDS[kind](5, 200.0)
    assert one.segments_m.shape != other.segments_m.shape or np.any(
        one.segments_m != other.segments_m
    )


def test_inner_walls_have_two_sides() -> None:
    """Rooms next to each other are 10 to 20 cm apart: the free floor ends that far before."""
    for seed in range(4):
        house = offices(seed, 320.0)
        loops = house.segments_m[4:].reshape(-1, 4, 4)[:6, :, :2]
        thickness = np.ptp(loops, axis=1).min(axis=1)
        assert np.all((thickness >= 0.1) & (thickness <= 0.2))


def half_turned(room: World, pose: Pose2) -> Pose2:
    middle = room.outline_m.min(axis=0) + room.outline_m.max(axis=0)
    return Pose2(middle[0] - pose.x_m, middle[1] - pose.y_m, pose.theta_rad + np.pi)


def test_a_symmetric_hall_looks_the_same_after_a_half_turn_unless_odd_things_tell() -> None:
    model, rng = ScannerModel(quantum_m=0.0), np.random.default_rng(0)
    differences = []
    for room in (symmetric(2, 320.0), symmetric(2, 320.0, odd_things=3)):
        worst = 0.0
        for tour_pose in plan_tour(room).path_m[::60]:
            pose = Pose2(tour_pose[0], tour_pose[1], 0.3)
            one = take_scan(model, room, pose, rng).ranges_m
            other = take_scan(model, room, half_turned(room, pose), rng).ranges_m
            worst = max(worst, float(np.mean(np.abs(one - other) > 0.01)))
        differences.append(worst)
    assert differences[0] < 0.01  # beams that graze a corner
    assert differences[1] > 0.03


def test_a_robot_drives_through_office_doors() -> None:
    house = offices(1, 120.0)
    tour = plan_tour(house)
    robot = SimulatedRobot(world=house, world_from_map=tour.world_from_map, scanners=())
    follower = PathFollower(tour.path_in_map_m)
    while follower.laps < 1.0:
        robot.advance(*follower.steer(robot.map_from_base))
        assert robot.stamp_ns < 1500e9, "stuck"
    assert robot.bumps == 0


@pytest.mark.parametrize("name", SCANNERS)
def test_scanners_look_ahead_evenly(name: str) -> None:
    model = SCANNERS[name]
    scan = take_scan(model, laboratory(0), Pose2(8.0, 6.0, 0.0), np.random.default_rng(0))
    assert len(scan.ranges_m) == model.beams
    np.testing.assert_allclose(scan.angles_rad, -scan.angles_rad[::-1], atol=1e-9)
    assert np.nanmax(scan.ranges_m[np.isfinite(scan.ranges_m)]) < model.range_max_m
