from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import (
    EXACT,
    cloud_at,
    covered_poses,
    lab,
    mapped_lab,
    plain_cloud,
    room,
    tour_poses,
    world_of,
)

from amr_slam.clouds import CloudParams, cloud_from_scan
from amr_slam.geometry import Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.registration.error import nearest
from amr_slam.registration.rdnm import RdnmParams, of_map
from amr_slam.simulation import World, take_scan

HERE = Pose2(3.0, 2.2, 0.3)
PLACES = [HERE, Pose2(5.0, 3.5, -1.0), Pose2(2.0, 4.5, 2.0), Pose2(6.5, 1.5, 0.0)]


def scanned(
    world: World, poses: list[Pose2], sigma_m: float = 0.01, params: MapParams | None = None
) -> PointMap:
    grown, rng = PointMap(params or MapParams()), np.random.default_rng(0)
    for i, pose in enumerate(poses):
        grown.insert(cloud_at(world, pose, rng, sigma_m=sigma_m, stamp_ns=i), pose)
    return grown


def test_walls_lie_where_they_are_and_face_the_room() -> None:
    grown = scanned(room(), PLACES)
    target = grown.target()
    assert np.abs(room().clearance(target.points_m)).max() < 0.03
    known = np.any(target.normals != 0.0, axis=1)
    assert known.mean() > 0.9
    inwards = room().clearance(target.points_m[known] + 0.3 * target.normals[known])
    assert np.mean(inwards > 0.1) > 0.99  # in a corner, not the whole of 0.3 m
    np.testing.assert_allclose(np.linalg.norm(target.normals[known], axis=1), 1.0)
    low_x, low_y, high_x, high_y = grown.bounds()
    np.testing.assert_allclose([low_x, low_y, high_x, high_y], [0, 0, 8, 6], atol=0.06)
    assert grown.area_m2() == pytest.approx(48.0, rel=0.1)
    assert grown.path == list(enumerate(PLACES))


def test_the_order_of_the_scans_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    scans = [(cloud_at(room(), pose, rng, sigma_m=0.01), pose) for pose in PLACES]
    maps = []
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        grown = PointMap(MapParams())
        for i in order:
            grown.insert(*scans[i])
        maps.append(grown)
    for other in maps[1:]:
        for mine, theirs in ((maps[0].walls, other.walls), (maps[0].space, other.space)):
            np.testing.assert_array_equal(mine.keys, theirs.keys)
            np.testing.assert_allclose(mine.sums, theirs.sums, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("scans", "gone"), [(1, False), (12, True)])
def test_who_walked_on_vanishes_from_the_map(scans: int, gone: bool) -> None:
    """A person stands there in one scan and not in the next ones."""
    person = np.array([[4.5, 3.0]])
    rng = np.random.default_rng(0)
    grown = PointMap(MapParams())
    grown.insert(cloud_at(room(), HERE, rng, sigma_m=0.005, people_m=person), HERE)
    assert np.hypot(*(grown.target().points_m - person).T).min() < 0.3
    for i in range(scans):
        pose = PLACES[i % 4]
        grown.insert(cloud_at(room(), pose, rng, sigma_m=0.005), pose)
    left = np.hypot(*(grown.target().points_m - person).T).min() < 0.3
    assert left != gone
    # ... and no wall went with her.
    walls = np.stack(np.meshgrid(np.arange(0.5, 8.0, 0.5), [0.0, 6.0]), axis=-1).reshape(-1, 2)
    assert nearest(walls, grown.target().tree).max() < 0.1


def test_a_thin_board_keeps_a_direction_seen_from_both_sides() -> None:
    board = np.array([[2.0, 3.0, 6.0, 3.0]])
    world = world_of(np.concatenate([room().segments_m, board]))
    grown = scanned(world, [Pose2(4.0, 1.5, 0.0), Pose2(4.0, 4.5, 0.0)])
    target = grown.target()
    on_board = (np.abs(target.points_m[:, 1] - 3.0) < 0.06) & (
        np.abs(target.points_m[:, 0] - 4.0) < 1.5
    )
    normals = target.normals[on_board]
    assert on_board.sum() > 40
    assert np.mean(np.abs(normals[:, 1]) > 0.95) > 0.9


def test_noisy_walls_are_straightened() -> None:
    poses = [pose @ Pose2(0.1 * k, 0.0, 0.2 * k) for pose in PLACES for k in range(4)]
    thick = scanned(room(), poses, 0.1, MapParams(thin=False)).target().points_m
    thin = scanned(room(), poses, 0.1).target().points_m
    inner = [
        points[(np.abs(points[:, 0] - 4.0) < 3.0) & (points[:, 1] < 1.0)]
        for points in (thick, thin)
    ]
    rms = [math.sqrt(float(np.mean(points[:, 1] ** 2))) for points in inner]
    assert rms[1] < 0.03
    assert rms[1] < 0.5 * rms[0]


@pytest.mark.parametrize("radius", [0.2, 0.5])
def test_places_leave_room_for_the_robot(radius: float) -> None:
    grown = mapped_lab(0)
    places = grown.places(0.5, radius)
    assert len(places) > 100
    assert nearest(places, grown.target().tree, radius).min() == math.inf
    # In truth too, but for walls that were never seen. Table tops are not: no scanner sees them.
    bare = replace(lab(0), table_tops_m=np.empty((0, 4)))
    assert np.mean(bare.clearance(places) > radius - grown.params.cell_m) > 0.98
    fewer = grown.places(0.5, 1.0)
    assert {tuple(p) for p in fewer.tolist()} < {tuple(p) for p in places.tolist()}


def test_places_are_everywhere_the_robot_was() -> None:
    places = mapped_lab(0).places(0.5, 0.3)
    driven = np.array([pose.translation for pose in tour_poses(0)])
    distance = np.hypot(*np.moveaxis(driven[:, None] - places, 2, 0)).min(axis=1)
    assert distance.max() < 0.5


def test_what_is_derived_follows_the_map() -> None:
    grown = scanned(room(), PLACES[:1])
    params = RdnmParams()
    before, h_before = grown.signatures(0.5, 0.3, params)
    assert grown.signatures(0.5, 0.3, params)[1] is h_before
    other = grown.signatures(0.5, 0.3, replace(params, sections=60))[1]
    assert other.shape == (len(before), 60)
    target = grown.target()
    grown.insert(cloud_at(room(), PLACES[1], np.random.default_rng(1)), PLACES[1])
    assert len(grown.target()) > len(target)
    places, h = grown.signatures(0.5, 0.3, params)
    assert h is not h_before
    np.testing.assert_array_equal(h, of_map(grown.target(), places, params))


def test_a_part_of_the_map_is_that_part() -> None:
    grown = mapped_lab(0)
    centre = tour_poses(0)[10]
    part = grown.target(centre, 3.0).points_m
    whole = grown.target().points_m
    near = whole[np.hypot(*(whole - centre.translation).T) < 3.0 - 0.05]
    assert {tuple(p) for p in near.tolist()} <= {tuple(p) for p in part.tolist()}
    assert np.hypot(*(part - centre.translation).T).max() < 3.05


def test_free_space_walls_and_the_unseen_are_told_apart() -> None:
    target = scanned(room(), PLACES).target()
    points = np.array([[4.0, 3.0], [4.0, 0.02], [4.0, -3.0], [100.0, 100.0]])
    free = target.lookup.seen_free(points)
    np.testing.assert_array_equal(free, [True, False, False, False])


def test_scans_at_their_own_pose_contradict_nothing() -> None:
    rng = np.random.default_rng(2)
    target = mapped_lab(1).target()
    for pose in covered_poses(1, 5):
        moved = pose @ cloud_at(lab(1), pose, rng, sigma_m=0.01).points_m
        distance = nearest(moved, target.tree)
        assert np.mean(target.lookup.seen_free(moved) & (distance > 0.25)) < 0.02
        assert np.mean(distance < 0.3) > 0.9


def test_an_empty_map_answers_too() -> None:
    grown = PointMap(MapParams())
    assert len(grown) == 0
    assert len(grown.target()) == 0
    assert len(grown.target(HERE)) == 0
    assert grown.places(0.5, 0.3).shape == (0, 2)
    assert grown.signatures(0.5, 0.3, RdnmParams())[1].shape[0] == 0
    assert grown.bounds() == (0.0, 0.0, 0.0, 0.0)
    assert grown.area_m2() == 0.0


@settings(derandomize=True, deadline=None, max_examples=30)
@given(
    rows=st.lists(st.tuples(st.floats(-30, 30), st.floats(-30, 30)), max_size=12),
    x=st.floats(-100, 100),
    theta=st.floats(-3, 3),
)
def test_any_scan_can_be_inserted(rows: list[tuple[float, float]], x: float, theta: float) -> None:
    """Points on the scanner itself included."""
    points = np.array([*rows, (0.0, 0.0)]).reshape(-1, 2)
    grown = PointMap(MapParams())
    grown.insert(plain_cloud(points), Pose2(x, 0.0, theta))
    assert np.all(np.isfinite(grown.walls.sums))
    assert 0.0 < float(grown.walls.sums[:, 0].sum()) <= len(points)
    assert np.all(np.isfinite(grown.target().points_m))


def test_an_empty_scan_adds_no_wall() -> None:
    blind = take_scan(replace(EXACT, range_max_m=0.1), room(), HERE, np.random.default_rng(0))
    grown = scanned(room(), PLACES[:1])
    points = len(grown)
    grown.insert(cloud_from_scan(blind, Pose2.identity(), CloudParams()), HERE)
    assert len(grown) == points
