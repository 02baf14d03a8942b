from __future__ import annotations

import copy
import math
from itertools import pairwise

import numpy as np
from labs import cloud_at, room

from amr_slam.geometry import Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.map.rays import BYTES_PER_RAY, forget, pack

POSES = [Pose2(2.0 + 0.5 * i, 2.0 + 0.2 * i, 0.4 * i) for i in range(8)]


def grown_room(poses: list[Pose2]) -> PointMap:
    grown, rng = PointMap(MapParams()), np.random.default_rng(0)
    for i, pose in enumerate(poses):
        grown.insert(cloud_at(room(), pose, rng, sigma_m=0.01, stamp_ns=i), pose)
    return grown


def test_a_cloud_comes_back_rounded() -> None:
    cloud = cloud_at(room(), POSES[1], np.random.default_rng(0), sigma_m=0.01)
    rays = pack(cloud)
    again = rays.cloud(cloud.stamp_ns, cloud.sigma_m)
    np.testing.assert_allclose(again.points_m, cloud.points_m, atol=1e-3)
    np.testing.assert_allclose(again.origins_m, cloud.origins_m, atol=1e-3)
    np.testing.assert_allclose(again.normals, cloud.normals, atol=1e-3)
    np.testing.assert_allclose(again.weights, cloud.weights, atol=0.01)
    np.testing.assert_array_equal(again.has_normal, cloud.has_normal)
    assert (again.sigma_m, again.across_m) == (cloud.sigma_m, cloud.across_m)
    arrays = (rays.ends, rays.origins, rays.normals, rays.weights)
    assert sum(array.nbytes for array in arrays) == BYTES_PER_RAY * len(cloud)


def test_a_map_can_be_rebuilt_at_other_poses() -> None:
    grown = grown_room(POSES)
    same = grown.rebuilt([pose for _, pose in grown.path])
    assert same.path == grown.path
    assert float(same.walls.sums[:, 7].sum()) == float(grown.walls.sums[:, 7].sum())
    shift = Pose2(3.0, -1.0, 0.5)
    moved = grown.rebuilt([shift @ pose for _, pose in grown.path])
    back = shift.inverse() @ moved.target().points_m
    assert np.abs(room().clearance(back)).max() < 0.04


def test_what_is_appended_is_drawn_once_when_it_is_asked_for() -> None:
    rng, one, other = np.random.default_rng(0), PointMap(MapParams()), PointMap(MapParams())
    for i, pose in enumerate(POSES):
        cloud = cloud_at(room(), pose, rng, sigma_m=0.01, stamp_ns=i)
        one.append(cloud, pose)
        other.insert(pack(cloud).cloud(i, cloud.sigma_m), pose)
    twin = copy.copy(one)
    assert one.path == other.path == twin.path
    for drawn in (twin, one):
        np.testing.assert_array_equal(drawn.walls.keys, other.walls.keys)
        np.testing.assert_allclose(drawn.walls.sums, other.walls.sums, atol=1e-9)
        np.testing.assert_array_equal(drawn.space.keys, other.space.keys)
        np.testing.assert_array_equal(drawn.space.sums, other.space.sums)


def test_nothing_is_forgotten_before_it_is_drawn() -> None:
    """Rays of a whole drive are more than its first part has room for."""
    cloud = cloud_at(room(), POSES[0], np.random.default_rng(0), sigma_m=0.01)
    grown = PointMap(MapParams())
    for i in range(600):
        grown.append(cloud, Pose2(0.5 * i, 2.0, 0.0))
    counted = sum(len(rays) for rays in grown.rays)
    assert float(grown.walls.sums[:, 7].sum()) == counted


def test_memory_is_bounded_and_the_oldest_of_near_scans_goes() -> None:
    rng = np.random.default_rng(0)
    poses = [*POSES, POSES[3] @ Pose2(0.05, 0.0, 0.0)]
    rays = [pack(cloud_at(room(), pose, rng)) for pose in poses]
    count = len(rays[0])
    # Room for two scans less, whatever the area: the floor is 500 kB.
    often = [one for one in rays for _ in range(6)]
    places = [pose for pose in poses for _ in range(6)]
    forget(often, places, 0.0)
    kept = [i for i, one in enumerate(often) if len(one)]
    assert BYTES_PER_RAY * sum(len(often[i]) for i in kept) <= 500_000
    assert BYTES_PER_RAY * (sum(len(often[i]) for i in kept) + count) > 400_000
    # Of each six at one place the newest is left; the distinct places are all there.
    assert {i // 6 for i in kept} == set(range(len(poses)))
    assert all(6 * (i // 6) + 5 in kept for i in kept)
    assert all(a < b for a, b in pairwise(kept))
    assert not math.isnan(often[kept[0]].quantum_m)
