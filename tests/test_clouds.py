from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from labs import EXACT, room, world_of

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Scan
from amr_slam.simulation import laboratory, take_scan

PARAMS = CloudParams()
HERE = Pose2.identity()


def cloud_of(scan: Scan, mounting: Pose2 = HERE, *, upside_down: bool = False) -> Cloud:
    return cloud_from_scan(scan, mounting, PARAMS, upside_down=upside_down)


@pytest.mark.parametrize("sigma", [0.01, 0.03, 0.1])
@pytest.mark.parametrize("seed", [0, 1])
def test_noise_is_estimated_from_the_scan_itself(sigma: float, seed: int) -> None:
    """In a furnished room, corners and edges may add a fifth: trusting less is the safe side."""
    rng = np.random.default_rng(seed)
    model = replace(EXACT, sigma_range_m=sigma)
    world = laboratory(seed)
    inside = world.outline_m.mean(axis=0)
    candidates = inside + rng.uniform(-3.0, 3.0, (200, 2))
    place = candidates[np.argmax(world.clearance(candidates))]
    for where, pose, most in (
        (room(), Pose2(3.0, 2.5, 0.4), 1.15),
        (world, Pose2(place[0], place[1], 1.0), 1.25),
    ):
        found = [cloud_of(take_scan(model, where, pose, rng)).sigma_m for _ in range(10)]
        assert 0.9 < np.mean(found) / sigma < most


@pytest.mark.parametrize("readings", [0, 4, 9])
def test_too_few_readings_tell_no_noise(readings: int) -> None:
    scan = take_scan(
        replace(EXACT, sigma_range_m=0.02), room(), Pose2(3, 2, 0), np.random.default_rng(0)
    )
    ranges = np.full(541, math.nan)
    ranges[:readings] = scan.ranges_m[:readings]
    assert cloud_of(replace(scan, ranges_m=ranges)).sigma_m == 0.0


@pytest.mark.parametrize("slant_deg", [0.0, 20.0, 40.0])
def test_normals_of_a_wall_stand_on_it_and_face_the_scanner(slant_deg: float) -> None:
    wall = world_of(np.array([[3.0, -20.0, 3.0, 20.0]]))
    rng = np.random.default_rng(2)
    scan = take_scan(
        replace(EXACT, sigma_range_m=0.005), wall, Pose2(0, 0, math.radians(slant_deg)), rng
    )
    cloud = cloud_of(scan)
    near = cloud.has_normal & (np.linalg.norm(cloud.points_m, axis=1) < 6.0)
    assert near.sum() > 100
    turned = cloud.normals[near] @ Pose2(0, 0, math.radians(slant_deg)).rotation.T
    off_deg = np.degrees(np.arctan2(turned[:, 1], -turned[:, 0]))
    assert math.sqrt(float(np.mean(off_deg**2))) < 2.0
    exact = cloud_of(take_scan(EXACT, wall, Pose2(0, 0, math.radians(slant_deg)), rng))
    known = exact.normals[exact.has_normal] @ Pose2(0, 0, math.radians(slant_deg)).rotation.T
    np.testing.assert_allclose(known, np.tile([-1.0, 0.0], (len(known), 1)), atol=1e-6)


def moving(first: Pose2, last: Pose2, beams: int) -> Array:
    share = np.linspace(0.0, 1.0, beams)[:, None]
    return np.asarray(first.as_array() + share * (last.as_array() - first.as_array()))


@pytest.mark.parametrize("mounting", [HERE, Pose2(0.24, 0.2, 0.7)])
def test_a_deskewed_scan_is_that_of_a_standing_robot(mounting: Pose2) -> None:
    model = replace(EXACT, base_from_lidar=mounting, sweep_s=0.08)
    middle = Pose2(4.0, 3.0, 0.5)
    # 1.5 m/s and 90 deg/s for 80 ms.
    twist = 0.04 * np.array([1.5, 0.0, 0.5 * math.pi])
    first, last = middle @ Pose2.exp(-twist), middle @ Pose2.exp(twist)
    bent = take_scan(model, room(), moving(first, last, model.beams), np.random.default_rng(0))
    sweep = (middle.inverse() @ first, middle.inverse() @ last)
    straight = cloud_from_scan(bent, mounting, PARAMS, sweep=sweep)
    ignored = cloud_from_scan(bent, mounting, PARAMS)
    off = np.abs(room().clearance(middle @ straight.points_m))
    assert off.max() < 0.01
    assert np.abs(room().clearance(middle @ ignored.points_m)).max() > 0.05
    assert straight.stamp_ns == bent.mid_stamp_ns
    # Origins move with the beams: each is where the scanner was for that point.
    spread = np.ptp(straight.origins_m, axis=0)
    assert np.hypot(*spread) == pytest.approx(0.12, abs=0.06)
    # Beam by beam against a scan from the middle: a wall's points shift along it, not off it.
    still = cloud_of(take_scan(model, room(), middle, np.random.default_rng(0)), mounting)
    assert len(still) == pytest.approx(len(straight), abs=5)


def test_a_hanging_scanner_sees_the_mirror_image() -> None:
    rng = np.random.default_rng(0)
    pose = Pose2(3.0, 2.0, 0.3)
    upright = take_scan(EXACT, room(), pose, rng)
    # What hangs upside down sweeps clockwise in the robot's frame: its readings come reversed.
    hanging = replace(upright, ranges_m=upright.ranges_m[::-1])
    np.testing.assert_allclose(
        cloud_of(hanging, upside_down=True).points_m[::-1], cloud_of(upright).points_m, atol=1e-9
    )
    wrong = cloud_of(hanging).points_m
    np.testing.assert_allclose(wrong[::-1] * [1.0, -1.0], cloud_of(upright).points_m, atol=1e-9)
    facing = cloud_of(hanging, upside_down=True)
    assert np.all(np.sum(facing.normals * facing.points_m, axis=1) <= 0.0)


def test_points_lie_where_the_mounting_puts_them() -> None:
    mounting, pose = Pose2(0.3, -0.2, 1.2), Pose2(3.0, 2.0, -0.6)
    model = replace(EXACT, base_from_lidar=mounting)
    cloud = cloud_of(take_scan(model, room(), pose, np.random.default_rng(0)), mounting)
    assert np.abs(room().clearance(pose @ cloud.points_m)).max() < 1e-9
    np.testing.assert_allclose(cloud.origins_m, np.tile([0.3, -0.2], (len(cloud), 1)))


@pytest.mark.parametrize(
    "ranges",
    [
        [],
        [math.inf] * 541,
        [math.nan] * 541,
        [math.nan, math.inf] * 270,
        [-1.0] * 541,
        [0.0] * 541,
        [1e308] * 541,
        [-math.inf] * 541,
        [2.0],  # an isolated return is dust
    ],
)
@pytest.mark.parametrize("moving_too", [False, True])
def test_useless_readings_give_an_empty_cloud(ranges: list[float], moving_too: bool) -> None:
    """Silently: warnings are errors in this suite."""
    scan = Scan(
        scanner="front",
        stamp_ns=7,
        ranges_m=np.array(ranges),
        angle_min_rad=-2.0,
        angle_step_rad=0.01,
        sweep_s=0.03,
    )
    sweep = (Pose2(-0.1, 0.0, -0.1), Pose2(0.1, 0.0, 0.1)) if moving_too else None
    cloud = cloud_from_scan(scan, HERE, PARAMS, sweep=sweep)
    assert len(cloud) == 0
    for rows in (cloud.points_m, cloud.normals, cloud.origins_m):
        assert rows.shape == (0, 2)
    assert cloud.weights.shape == (0,)
    assert cloud.sigma_m == 0.0


def test_damaged_readings_cost_only_themselves() -> None:
    rng = np.random.default_rng(0)
    scan = take_scan(EXACT, room(), Pose2(3.0, 2.0, 0.0), rng)
    ranges = scan.ranges_m.copy()
    gone = rng.choice(len(ranges), 100, replace=False)
    ranges[gone] = rng.choice([math.nan, math.inf, -1.0, 0.0], 100)
    cloud = cloud_of(replace(scan, ranges_m=ranges))
    assert len(cloud) == pytest.approx(441, abs=10)
    assert np.all(np.isfinite(cloud.points_m))
    assert np.all(np.isfinite(cloud.normals))
    assert np.all((cloud.weights > 0.0) & (cloud.weights <= 1.0))
    assert np.abs(room().clearance(Pose2(3.0, 2.0, 0.0) @ cloud.points_m)).max() < 1e-9


def test_readings_out_of_range_are_dropped() -> None:
    scan = take_scan(EXACT, room(), Pose2(3.0, 2.0, 0.0), np.random.default_rng(0))
    params = CloudParams(range_min_m=2.5, range_max_m=4.0)
    distance = np.linalg.norm(cloud_from_scan(scan, HERE, params).points_m, axis=1)
    assert distance.min() >= 2.5
    assert distance.max() <= 4.0
    nearer = replace(scan, range_max_m=3.0)
    assert np.linalg.norm(cloud_of(nearer).points_m, axis=1).max() <= 3.0


def test_two_scanners_become_one_cloud_at_one_instant() -> None:
    """The second scan was taken half a metre earlier: its own pose puts it in place."""
    rng = np.random.default_rng(0)
    now = Pose2(4.0, 3.0, 0.2)
    now_from_then = Pose2(-0.5, 0.05, -0.3)
    a = cloud_of(take_scan(EXACT, room(), now, rng, stamp_ns=5))
    b = cloud_of(
        take_scan(replace(EXACT, sigma_range_m=0.03), room(), now @ now_from_then, rng, stamp_ns=3)
    )
    both = merge([(a, Pose2.identity()), (b, now_from_then)])
    assert (both.stamp_ns, len(both)) == (a.stamp_ns, len(a) + len(b))
    off = room().clearance(now @ both.points_m)
    assert np.abs(off[: len(a)]).max() < 1e-9
    assert math.sqrt(float(np.mean(off[len(a) :] ** 2))) < 0.04
    assert both.sigma_m == b.sigma_m > a.sigma_m
    towards = np.sum((both.origins_m - both.points_m) * both.normals, axis=1)
    assert np.all(towards >= 0.0)


def test_near_things_do_not_outweigh_walls() -> None:
    """A leg at 0.4 m fills many beams, each standing for little surface."""
    leg = np.array([[0.4, -0.05, 0.4, 0.05]])
    wall = np.array([[6.0, -20.0, 6.0, 20.0]])
    cloud = cloud_of(
        take_scan(EXACT, world_of(np.concatenate([leg, wall])), HERE, np.random.default_rng(0))
    )
    near = cloud.points_m[:, 0] < 1.0
    assert near.sum() > 20
    assert cloud.weights[near].max() < 0.15
    # ... so that the leg's weight is what its ten centimetres of surface are to the wall's.
    assert cloud.weights[near].sum() < 0.1 * cloud.weights[~near].sum()
