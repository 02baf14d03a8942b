"""Exhaustive search in a likelihood field."""

from __future__ import annotations

import math

import numpy as np
import pytest
from labs import cloud_at, covered_poses, exact_target, heading_error_rad, lab, mapped_lab, room

from amr_slam.geometry import Pose2
from amr_slam.registration import field
from amr_slam.registration.alignment import Target
from amr_slam.registration.field import FieldParams

PARAMS = FieldParams()
# A cell's diagonal off in place, a heading's step off in heading: what a rough pose may be.
OFF_M = math.hypot(PARAMS.spacing_m, PARAMS.spacing_m)
OFF_RAD = 1.5 * math.tau / PARAMS.headings


@pytest.mark.parametrize("sigma_m", [0.01, 0.1])
def test_the_right_pose_is_among_the_candidates(sigma_m: float) -> None:
    grown, rng = mapped_lab(0), np.random.default_rng(0)
    places = grown.places(PARAMS.spacing_m, 0.3)
    for pose in covered_poses(0, 12):
        cloud = cloud_at(lab(0), pose, rng, sigma_m=sigma_m)
        rough = field.search(cloud, grown.field(PARAMS), places, PARAMS)
        assert len(rough) == PARAMS.candidates
        assert np.all(np.diff(rough[:, 3]) <= 0.0)
        off = [Pose2.from_array(row[:3]) for row in rough]
        assert any(
            one.distance_to(pose) < OFF_M and heading_error_rad(one, pose) < OFF_RAD for one in off
        )


def test_values_are_how_near_the_walls_are() -> None:
    walls = exact_target(room())
    free = np.stack(np.meshgrid(np.arange(0.55, 7.5, 0.1), np.arange(0.55, 5.5, 0.1)), axis=-1)
    target = Target(points_m=walls.points_m, normals=walls.normals, free_m=free.reshape(-1, 2))
    found = field.build(target, PARAMS)
    row, column = np.indices(found.values.shape)
    x = found.x0_m + (column + 0.5) * found.cell_m
    y = found.y0_m + (row + 0.5) * found.cell_m
    inside = np.minimum(np.minimum(x, 8.0 - x), np.minimum(y, 6.0 - y))
    near = np.abs(inside) < 0.5
    along = near & (x > 0.3) & (x < 7.7) & (y > 0.3) & (y < 5.7)
    expected = 100.0 * (1.0 - np.abs(inside) / PARAMS.reach_m)
    np.testing.assert_allclose(found.values[along], expected[along], atol=6.0)
    assert np.all(found.values[inside > 0.8] == -30)
    assert np.all(found.values[inside < -0.8] == 0)


def test_the_scores_are_of_the_pose_that_they_name() -> None:
    """Of 90 points on the walls of a bare room, nearly all lie on them at the true pose only."""
    target = exact_target(room())
    truth = Pose2(3.0, 2.2, 8 * math.tau / PARAMS.headings)
    cloud = cloud_at(room(), truth, np.random.default_rng(0))
    places = np.array([[3.0, 2.2], [4.4, 3.0], [2.0, 4.0]])
    rough = field.search(cloud, field.build(target, PARAMS), places, PARAMS)
    np.testing.assert_allclose(rough[0, :3], truth.as_array(), atol=1e-9)
    assert rough[0, 3] > 0.8


def test_fewer_hypotheses_than_candidates_are_all_there_are() -> None:
    target = exact_target(room())
    cloud = cloud_at(room(), Pose2(3.0, 2.2, 0.1), np.random.default_rng(0))
    params = FieldParams(headings=4)
    known = field.build(target, params)
    assert len(field.search(cloud, known, np.array([[3.0, 2.2], [4.0, 3.0]]), params)) == 8
    assert field.search(cloud, known, np.empty((0, 2)), params).shape == (0, 4)


def test_places_outside_of_the_field_are_no_error() -> None:
    target = exact_target(room())
    cloud = cloud_at(room(), Pose2(3.0, 2.2, 0.1), np.random.default_rng(0))
    places = np.array([[-50.0, 2.0], [3.0, 400.0], [3.0, 2.2]])
    rough = field.search(cloud, field.build(target, PARAMS), places, PARAMS)
    np.testing.assert_array_equal(rough[0, :2], [3.0, 2.2])
    assert np.all(rough[:, 3] <= rough[0, 3])
