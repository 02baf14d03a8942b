from __future__ import annotations

import math

import numpy as np
import pytest
from labs import cloud_at, covered_poses, lab, room, tour_poses

from amr_slam.clouds import CloudParams, cloud_from_scan
from amr_slam.geometry import Array, Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.map.file import decode, encode
from amr_slam.registration.error import nearest
from amr_slam.simulation import ScannerModel, cast, take_scan

SPOTS = [Pose2(1.5 + 0.25 * i, 1.5 + 0.14 * i, 0.7 * i) for i in range(20)]


def noisy_room(sigma_m: float, poses: list[Pose2], *, seed: int = 0) -> PointMap:
    grown, rng = PointMap(MapParams()), np.random.default_rng(seed)
    for pose in poses:
        grown.insert(cloud_at(room(), pose, rng, sigma_xy_m=sigma_m), pose)
    return grown


def rms(distances_m: Array) -> float:
    return math.sqrt(float(np.mean(distances_m**2)))


def off_walls(points_m: Array) -> Array:
    """Distance of points to the nearest wall of the room."""
    x, y = points_m.T
    sides = [np.abs(x), np.abs(8.0 - x), np.abs(y), np.abs(6.0 - y)]
    return np.asarray(np.minimum.reduce(sides), dtype=np.float64)


@pytest.mark.parametrize(("sigma", "most"), [(0.03, 0.008), (0.1, 0.025), (0.2, 0.05), (0.3, 0.08)])
def test_bands_become_lines(sigma: float, most: float) -> None:
    target = noisy_room(sigma, SPOTS).target()
    assert rms(off_walls(target.points_m)) < most
    walls = np.stack(np.meshgrid(np.arange(0.5, 7.6, 0.1), [0.0, 6.0]), axis=-1).reshape(-1, 2)
    assert np.mean(nearest(walls, target.tree) < max(0.1, 0.5 * sigma)) > 0.95
    np.testing.assert_allclose(np.linalg.norm(target.normals, axis=1), 1.0)
    inner = np.all((target.points_m > -0.5) & (target.points_m < [8.5, 6.5]), axis=1)
    ahead = np.abs(target.points_m + 0.5 * target.normals - [4.0, 3.0]) / [4.0, 3.0]
    assert np.mean(ahead[inner].max(axis=1) < 1.0) > 0.95  # normals face the room


def test_following_scan_by_scan_ends_where_settling_does() -> None:
    grown, rng = PointMap(MapParams()), np.random.default_rng(0)
    for pose in SPOTS:
        grown.insert(cloud_at(room(), pose, rng, sigma_xy_m=0.1), pose)
        latest = grown.target(pose)
    settled = grown.target()
    assert latest.points_m is not settled.points_m
    assert rms(off_walls(latest.points_m)) < 1.2 * rms(off_walls(settled.points_m)) + 0.002
    assert np.percentile(nearest(latest.points_m, settled.tree), 90) < 0.05
    # Asked near a pose again, the settled walls are at hand.
    again = grown.target(SPOTS[-1]).points_m
    np.testing.assert_array_equal(again, settled.points_m)


def test_the_map_grows_over_its_edges() -> None:
    """Scans of one end, then of the other: what was there stays."""
    grown, rng = PointMap(MapParams()), np.random.default_rng(0)
    world = room(40.0, 5.0)
    model = ScannerModel(sigma_xy_m=0.1, range_max_m=6.0, sweep_s=0.0)
    for x in np.concatenate([np.arange(20.0, 38.0, 0.5), np.arange(20.0, 2.0, -0.5)]):
        pose = Pose2(float(x), 2.5, float(x))
        scan = take_scan(model, world, pose, rng)
        grown.insert(cloud_from_scan(scan, Pose2.identity(), CloudParams()), pose)
        latest = grown.target(pose, math.inf)
    x, y = latest.points_m.T
    assert rms(np.minimum(np.abs(y), np.abs(5.0 - y))[(x > 5.0) & (x < 35.0)]) < 0.035
    for begin in range(6, 34, 4):
        assert np.sum((x > begin) & (x < begin + 4)) > 100


def test_a_person_does_not_stay_in_a_noisy_map() -> None:
    person = np.array([[4.5, 3.0]])
    rng = np.random.default_rng(0)
    grown = PointMap(MapParams())
    for i, pose in enumerate(SPOTS):
        people = person if i < 2 else None
        grown.insert(cloud_at(room(), pose, rng, sigma_xy_m=0.05, people_m=people), pose)
    assert np.hypot(*(grown.target().points_m - person).T).min() > 0.5


def test_walls_in_a_laboratory_are_found_and_nothing_else() -> None:
    """Noise of 0.1 m: thin points on walls, and most of what was seen is there."""
    seed = 3
    grown, rng = PointMap(MapParams()), np.random.default_rng(seed)
    seen = []
    for pose in tour_poses(seed):
        grown.insert(cloud_at(lab(seed), pose, rng, sigma_xy_m=0.1), pose)
        angles = np.arange(0.0, 2.0 * math.pi, 0.02)
        origin = np.broadcast_to(pose.translation, (len(angles), 2))
        reach = cast(origin, angles, lab(seed).segments_m)
        seen.append(origin + reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))
    walls = np.concatenate(seen)
    target = grown.target()
    off = np.abs(lab(seed).clearance(target.points_m))
    assert np.median(off) < 0.015
    assert np.mean(off < 0.1) > 0.97
    assert np.mean(nearest(walls, target.tree) < 0.1) > 0.9
    for pose in covered_poses(seed, 5):
        moved = pose @ cloud_at(lab(seed), pose, rng, sigma_xy_m=0.1).points_m
        distance = nearest(moved, target.tree)
        free = target.lookup.seen_free(moved) & (distance > 0.5)
        assert free.mean() < 0.02  # the band of a noisy wall is no free space
        assert np.mean(distance < 0.3) > 0.9


def test_walls_too_far_apart_for_an_image_stay_bands() -> None:
    grown = noisy_room(0.1, SPOTS[:2])
    rng = np.random.default_rng(0)
    grown.insert(cloud_at(room(), SPOTS[2], rng, sigma_xy_m=0.1), Pose2(1e5, 1e5, 0.0))
    target = grown.target()
    assert len(target) > 1000
    assert len(grown.target(SPOTS[0])) > 500


def test_exact_scans_are_left_alone() -> None:
    grown, plain = PointMap(MapParams()), PointMap(MapParams(thin=False))
    for one in (grown, plain):
        rng = np.random.default_rng(0)
        for pose in SPOTS[:4]:
            one.insert(cloud_at(room(), pose, rng, sigma_m=0.01), pose)
    np.testing.assert_array_equal(grown.target().points_m, plain.target().points_m)


@pytest.mark.parametrize(("sigma", "cell_m"), [(0.01, 0.05), (0.1, 0.05), (0.3, 0.1)])
def test_noisy_maps_keep_their_walls_in_less_memory(sigma: float, cell_m: float) -> None:
    """Coarser cells under heavy noise; what was counted stays, and a saved map settles alike."""
    grown = noisy_room(sigma, SPOTS)
    assert grown.walls.cell_m == grown.params.cell_m == cell_m
    assert grown.walls.sums.dtype == (np.float64 if sigma < 0.02 else np.float32)
    rng, returns = np.random.default_rng(0), 0
    for pose in SPOTS:
        returns += len(cloud_at(room(), pose, rng, sigma_xy_m=sigma))
    assert float(grown.walls.sums[:, 7].sum()) == returns
    loaded, _ = decode(encode(grown)[0])
    np.testing.assert_array_equal(loaded.target().points_m, grown.target().points_m)
    extra = cloud_at(room(), SPOTS[3], rng, sigma_xy_m=sigma)
    for one in (grown, loaded):
        one.insert(extra, SPOTS[3])
    np.testing.assert_array_equal(loaded.target().points_m, grown.target().points_m)


def test_a_map_that_is_only_localized_in_keeps_no_image() -> None:
    grown = noisy_room(0.1, SPOTS)
    settled = grown.target()
    grown.places(0.5, 0.3)
    assert grown._deconvolution is None
    # The next scan finds what it needs: the walls are settled anew, then followed.
    rng = np.random.default_rng(1)
    for pose in SPOTS[:2]:
        grown.insert(cloud_at(room(), pose, rng, sigma_xy_m=0.1), pose)
        latest = grown.target(pose)
    assert grown._deconvolution is not None
    assert np.percentile(nearest(latest.points_m, settled.tree), 90) < 0.05
