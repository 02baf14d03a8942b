from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from labs import (
    cloud_at,
    exact_target,
    heading_error_rad,
    lab,
    mapped_lab,
    plain_cloud,
    room,
    tour_poses,
    world_of,
)
from numpy.typing import NDArray
from scipy.optimize import minimize

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2, rotation_matrix
from amr_slam.registration import icp
from amr_slam.registration.alignment import Target
from amr_slam.registration.icp import IcpParams, Prior

LINE = IcpParams(reach_m=0.8, narrowing_iterations=10, max_iterations=50)
POINT = IcpParams(metric="point", max_iterations=80)
STARTS = [
    Pose2(0.3 * x, 0.3 * y, math.radians(15.0) * turn)
    for x, y, turn in itertools.product((-1, 0, 1), repeat=3)
]


@pytest.mark.parametrize(
    ("params", "off_m", "off_deg"), [(LINE, 0.02, 0.3), (POINT, 0.05, 1.0)], ids=["line", "point"]
)
@pytest.mark.parametrize("place", [10, 30, 50])
def test_a_scan_finds_its_place_from_all_around(
    params: IcpParams, off_m: float, off_deg: float, place: int
) -> None:
    truth = tour_poses(0)[place]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(place), sigma_m=0.01)
    target = mapped_lab(0).target()
    found = icp.align_many(cloud, target, [truth @ start for start in STARTS], params)
    assert len(found) == len(STARTS)
    arrived = 0
    for alignment in found:
        pose = alignment.target_from_source
        if (
            pose.distance_to(truth) < off_m
            and math.degrees(heading_error_rad(pose, truth)) < off_deg
        ):
            arrived += 1
            assert alignment.converged
            assert alignment.inliers > 0.8
            assert alignment.rmse_m < 0.05
        else:
            # From the far corners of the window some may go astray: it must show.
            assert not alignment.converged or alignment.inliers < 0.5
    assert arrived >= len(STARTS) - 4


def umeyama(points: Array, data: Array) -> Pose2:
    """Least squares ``data_from_points`` by the singular value decomposition, the textbook's."""
    a, b = points.mean(axis=0), data.mean(axis=0)
    u, _, vt = np.linalg.svd((data - b).T @ (points - a))
    rotation = u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt
    x, y = b - rotation @ a
    return Pose2(x, y, math.atan2(rotation[1, 0], rotation[0, 0]))


@pytest.mark.parametrize("seed", range(5))
def test_point_metric_is_the_closed_form_where_pairs_are_plain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    points = 2.0 * grid + rng.uniform(-0.3, 0.3, grid.shape)
    small = Pose2.from_array(rng.uniform([-0.2, -0.2, -0.04], [0.2, 0.2, 0.04]))
    data = small @ points + rng.normal(0.0, 0.05, points.shape)
    target = Target(points_m=data, normals=np.zeros_like(data))
    found = icp.align(plain_cloud(points), target, Pose2.identity(), POINT)
    expected = umeyama(points, data)
    assert found.target_from_source.distance_to(expected) < 1e-9
    assert heading_error_rad(found.target_from_source, expected) < 1e-9
    assert found.inliers == pytest.approx(1.0, abs=0.2)


def wall_distances(pose: Array, cloud: Cloud, walls: NDArray[np.intp]) -> Array:
    """Of each point to its own wall of the room 8 x 6, exactly; ``walls`` (n,) is 0 to 3."""
    moved = cloud.points_m @ rotation_matrix(pose[2]).T + pose[:2]
    x, y = moved.T
    return np.choose(walls, [y, 8.0 - x, 6.0 - y, x])


@pytest.mark.parametrize("with_prior", [False, True])
def test_line_metric_with_a_prior_is_the_optimum_that_scipy_finds(with_prior: bool) -> None:
    truth = Pose2(3.0, 2.2, 0.3)
    sigma = 0.03
    full = cloud_at(room(), truth, np.random.default_rng(5), sigma_m=sigma)
    ends = truth @ full.points_m
    # Away from the corners every point has one wall, before and after.
    margins = np.stack([ends[:, 1], 8.0 - ends[:, 0], 6.0 - ends[:, 1], ends[:, 0]], axis=1)
    plain = full.has_normal & (np.sort(margins, axis=1)[:, 1] > 0.5)
    walls = np.argmin(margins, axis=1)
    facing = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]])[walls]
    plain &= np.sum((full.normals @ truth.rotation.T) * facing, axis=1) > 0.8
    walls = walls[plain]
    cloud = plain_cloud(full.points_m[plain], full.normals[plain], sigma)
    params = IcpParams(tolerance_m=1e-10, max_iterations=300, kernel_m=0.2, reach_m=0.6)
    believed = truth @ Pose2(0.04, -0.03, 0.01)
    prior = Prior(
        target_from_source=believed,
        information=np.linalg.inv(np.array([[4e-6, 1e-6, 0], [1e-6, 9e-6, 0], [0, 0, 1e-6]])),
    )
    found = icp.align(
        cloud, exact_target(room()), truth, params, prior if with_prior else None
    ).target_from_source
    variance = max(params.correlation * params.sigma_floor_m**2, 1.2 * sigma**2)

    def cost(pose: Array) -> float:
        squared = wall_distances(pose, cloud, walls) ** 2
        kernel = np.sum(squared / (1.0 + squared / 0.2**2)) / variance
        off = pose - believed.as_array()
        return float(0.5 * kernel + 0.5 * with_prior * off @ prior.information @ off)

    best = minimize(cost, truth.as_array(), method="Nelder-Mead", options={"xatol": 1e-9}).x
    np.testing.assert_allclose(found.as_array(), best, atol=2e-5)
    # The prior does pull, or this test would show nothing.
    assert not with_prior or found.distance_to(truth) > 5e-3


def test_the_far_side_of_a_thin_wall_does_not_attract() -> None:
    """A board of 10 cm seen from below only; the guess is off towards its upper face."""
    w = world_of(np.array([[0, 0, 9, 0], [9, 0, 9, 4], [9, 4, 0, 4], [0, 4, 0, 0]], dtype=float))
    upper = world_of(np.array([[0.0, 4.1, 9.0, 4.1]]))
    faces = [exact_target(w), exact_target(upper)]
    target = Target(
        points_m=np.concatenate([face.points_m for face in faces]),
        normals=np.concatenate([face.normals for face in faces]),
    )
    truth = Pose2(4.0, 2.0, 0.2)
    cloud = cloud_at(w, truth, np.random.default_rng(0))
    start = Pose2(truth.x_m, truth.y_m + 0.09, truth.theta_rad)
    found = icp.align(cloud, target, start, LINE).target_from_source
    assert found.distance_to(truth) < 5e-3


def test_a_person_in_the_scan_pulls_nothing() -> None:
    truth = tour_poses(0)[20]
    person = truth @ np.array([[1.2, 0.3]])
    rng = np.random.default_rng(1)
    cloud = cloud_at(lab(0), truth, rng, sigma_m=0.01, people_m=person)
    assert np.any(np.hypot(*(truth @ cloud.points_m - person).T) < 0.25)
    start = truth @ Pose2(0.1, -0.1, 0.05)
    found = icp.align(cloud, mapped_lab(0).target(), start, LINE).target_from_source
    assert found.distance_to(truth) < 0.02


def test_each_result_belongs_to_its_own_start() -> None:
    """Refined together or one by one, in any order: the same."""
    truth = tour_poses(0)[10]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(1), sigma_m=0.01)
    target = mapped_lab(0).target()
    starts = [truth @ start for start in STARTS[::5]] + [truth @ Pose2(3.0, 2.0, 1.0)]
    together = icp.align_many(cloud, target, starts, LINE)
    backwards = icp.align_many(cloud, target, starts[::-1], LINE)[::-1]
    for start, one, other in zip(starts, together, backwards, strict=True):
        alone = icp.align(cloud, target, start, LINE)
        for same in (one, other):
            assert same.target_from_source.distance_to(alone.target_from_source) < 1e-9
            assert same.iterations == alone.iterations
    assert together[-1].target_from_source.distance_to(truth) > 1.0


@pytest.mark.parametrize("params", [LINE, POINT], ids=["line", "point"])
def test_nothing_to_align_is_no_convergence(params: IcpParams) -> None:
    start = Pose2(1.0, 2.0, 0.5)
    empty = np.empty((0, 2))
    some = cloud_at(room(), Pose2(3, 2, 0), np.random.default_rng(0))
    nothing = Target(points_m=empty, normals=empty)
    for cloud, target in ((plain_cloud(empty), exact_target(room())), (some, nothing)):
        found = icp.align(cloud, target, start, params)
        assert not found.converged
        assert found.target_from_source == start
        assert found.inliers == 0.0
        assert not found.information.any()
    assert icp.align_many(some, exact_target(room()), [], params) == []


def test_too_few_points_are_no_convergence() -> None:
    some = cloud_at(room(), Pose2(3, 2, 0), np.random.default_rng(0))
    few = plain_cloud(some.points_m[:3], some.normals[:3])
    assert not icp.align(few, exact_target(room()), Pose2(3, 2, 0), LINE).converged


def test_far_from_every_wall_nothing_moves() -> None:
    cloud = cloud_at(room(), Pose2(3, 2, 0), np.random.default_rng(0))
    lost = Pose2(500.0, -300.0, 1.0)
    found = icp.align(cloud, exact_target(room()), lost, LINE)
    assert not found.converged
    assert found.target_from_source == lost
    assert not found.information.any()


def test_running_out_of_iterations_is_told() -> None:
    truth = tour_poses(0)[10]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0))
    few = replace(LINE, max_iterations=2)
    found = icp.align(cloud, mapped_lab(0).target(), truth @ Pose2(0.3, 0.3, 0.2), few)
    assert not found.converged
    assert found.iterations == 2
