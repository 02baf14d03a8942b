"""Scenes: what is mapped, what counts as covered, and what disturbs a scan."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from amr_slam.geometry import Pose2
from amr_slam.params import preset
from amr_slam.simulation import COVERED
from amr_slam.studies.scenes import (
    MAPPING_SCANS,
    RIGHT_RAD,
    ROBOT_RADIUS_M,
    S300,
    is_right,
    laboratory_scene,
    with_noise,
)
from amr_slam.studies.witnesses import UNMAPPED, half_map, half_of, step_from, unmapped_poses

SEED = 11


def test_scene_is_mapped_by_as_many_scans_as_the_papers() -> None:
    scene = laboratory_scene(SEED)
    assert len(scene.mapping) == MAPPING_SCANS
    steps = [a.distance_to(b) for a, b in itertools.pairwise(scene.mapping)]
    assert max(steps) < 0.8  # along one way, never a jump


def test_covered_poses_are_free_and_see_mapped_walls() -> None:
    scene = laboratory_scene(SEED)
    poses = scene.poses(10, np.random.default_rng(1))
    assert len(poses) == 10
    assert min(scene.coverage(pose) for pose in poses) > COVERED
    points = np.array([pose.translation for pose in poses])
    assert scene.world.clearance(points).min() >= ROBOT_RADIUS_M


def test_coverage_is_full_where_the_mapping_stood_and_low_beyond_a_half_map() -> None:
    scene = laboratory_scene(SEED)
    assert scene.coverage(scene.mapping[5]) == pytest.approx(1.0)
    half, cut_x = half_of(scene)
    far = max(scene.mapping, key=lambda pose: pose.x_m)
    towards_the_far_wall = Pose2(far.x_m, far.y_m, 0.0)
    assert far.x_m > cut_x + 2.0
    assert half.coverage(towards_the_far_wall) < 0.5 < scene.coverage(towards_the_far_wall)


def test_map_at_truth_lies_on_the_walls() -> None:
    scene = laboratory_scene(SEED)
    known = scene.map_at_truth(with_noise(0.0), preset("default"))
    offsets = np.abs(scene.world.clearance(known.target().points_m))
    assert np.quantile(offsets, 0.95) < 0.02


def test_half_map_ends_at_its_cut() -> None:
    scene = laboratory_scene(SEED)
    half, cut_x = half_of(scene)
    known = half_map(half, cut_x, S300, preset("default"), np.random.default_rng(1))
    assert len(known) > 0
    assert known.target().points_m[:, 0].max() < cut_x


def test_step_is_a_step_and_ends_where_there_is_room() -> None:
    scene = laboratory_scene(SEED)
    rng = np.random.default_rng(3)
    for pose in scene.mapping[::10]:
        further = step_from(scene, pose, rng)
        moved = (pose.inverse() @ further).as_array()
        turned_on_the_spot = np.hypot(*moved[:2]) < 1e-9 and abs(moved[2]) >= 0.3
        assert turned_on_the_spot or 0.6 <= np.hypot(*moved[:2]) <= 1.0
        assert scene.world.clearance(further.translation[None])[0] >= ROBOT_RADIUS_M


def test_right_is_within_a_quarter_metre_and_five_degrees() -> None:
    truth = Pose2(3.0, -2.0, 3.1)
    assert is_right(truth @ Pose2(0.24, 0.0, 0.99 * RIGHT_RAD), truth)
    assert not is_right(truth @ Pose2(0.26, 0.0, 0.0), truth)
    assert not is_right(truth @ Pose2(0.0, 0.0, -1.01 * RIGHT_RAD), truth)


def test_unmapped_poses_are_beyond_the_cut_and_see_hardly_a_mapped_wall() -> None:
    half, cut_x = half_of(laboratory_scene(SEED))
    poses = unmapped_poses(half, cut_x, 5, np.random.default_rng(4))
    assert len(poses) == 5
    assert min(pose.x_m for pose in poses) > cut_x
    assert max(half.coverage(pose) for pose in poses) < UNMAPPED
