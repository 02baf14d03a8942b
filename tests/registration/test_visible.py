"""The last stage under noise: each beam against the walls that its ray can meet."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from labs import (
    cloud_at,
    corridor,
    covered_poses,
    exact_target,
    lab,
    mapped_lab,
    plain_cloud,
    room,
)

from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array, Pose2
from amr_slam.registration import icp, information, visible
from amr_slam.registration.alignment import Target
from amr_slam.registration.icp import IcpParams, Prior

PARAMS = IcpParams()


@pytest.mark.skipif(not ENABLED, reason="nothing is compiled")
@pytest.mark.parametrize("sigma", [0.03, 0.2])
def test_compiled_and_numpy_equations_agree(sigma: float) -> None:
    truth = next(covered_poses(0, 1))
    cloud = cloud_at(lab(0), truth, np.random.default_rng(1), sigma_xy_m=sigma)
    target = mapped_lab(0).target()
    beams = cloud.points_m - cloud.origins_m
    reach = np.hypot(beams[:, 0], beams[:, 1])
    beams = beams / reach[:, None]
    moved, origins = truth @ cloud.points_m, truth @ cloud.origins_m
    directions = beams @ truth.rotation.T
    depths, lines = visible._walls(target, origins, directions, reach + 1.0)
    strides = visible._strides(beams, reach, cloud.across_m)
    given = (moved, origins, directions, strides, depths, lines, truth.translation)
    compiled = visible._equations(*given, cloud.sigma_m, cloud.across_m)
    plain = visible._equations_in_numpy(*given, cloud.sigma_m, cloud.across_m)
    assert compiled[0][0, 0] > 50.0
    np.testing.assert_allclose(compiled[0], plain[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(compiled[1], plain[1], rtol=1e-9, atol=1e-9)


def test_walls_that_a_beam_cannot_see_do_not_pull() -> None:
    """Noise carries points nearer to hidden walls than to their own: the nearest point errs."""
    nearest, seen = [], []
    for seed in (0, 1, 2):
        target = replace(exact_target(lab(seed)), sigma_m=0.3)
        rng = np.random.default_rng(seed)
        for truth in covered_poses(seed, 15):
            cloud = cloud_at(lab(seed), truth, rng, sigma_m=0.3)
            cloud = replace(cloud, normals=np.zeros_like(cloud.normals))
            before = icp.align(cloud, target, truth, PARAMS)
            after = icp.polish(cloud, target, before, PARAMS)
            nearest.append(before.target_from_source.distance_to(truth))
            seen.append(after.target_from_source.distance_to(truth))
    assert rms(seen) < 0.9 * rms(nearest)


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_rays_go_on_to_the_walls_behind() -> None:
    walls = np.array([[2.0, -1.0, 2.0, 1.0], [5.0, -1.0, 5.0, 1.0], [2.1, -1.0, 2.1, 1.0]])
    points = np.concatenate(
        [
            np.column_stack([np.full(40, x1), np.linspace(y1, y2, 40)])
            for x1, y1, _, y2 in walls
        ]
    )  # fmt: skip
    target = Target(points_m=points, normals=np.tile([-1.0, 0.0], (len(points), 1)))
    origins, ahead = np.zeros((2, 2)), np.array([[1.0, 0.0], [0.0, 1.0]])
    depths, lines = visible._walls(target, origins, ahead, np.full(2, 10.0))
    # Two walls 0.1 m behind one another are one.
    np.testing.assert_allclose(depths[0, :2], [2.0, 5.0], atol=1e-6)
    assert np.isinf(depths[0, 2])
    np.testing.assert_allclose(lines[0, :2], [[-1.0, 0.0, -2.0], [-1.0, 0.0, -5.0]], atol=1e-6)
    assert np.isinf(depths[1]).all()
    # ... and those beyond what the scan reaches are none.
    short, _ = visible._walls(target, origins, ahead, np.array([4.0, 4.0]))
    assert np.isinf(short[0, 1])


def test_scans_without_noise_keep_their_pose() -> None:
    truth = Pose2(3.0, 2.2, 0.3)
    cloud = cloud_at(room(), truth, np.random.default_rng(0), sigma_m=0.005)
    found = icp.align(cloud, exact_target(room()), truth, PARAMS)
    assert icp.polish(cloud, exact_target(room()), found, PARAMS) is found


def test_the_stage_counts_by_the_noise_without_a_step() -> None:
    levels = np.linspace(0.0, 0.1, 200)
    parts = [visible.share(plain_cloud(np.zeros((1, 2)), sigma_m=float(s))) for s in levels]
    assert (parts[0], parts[-1]) == (0.0, 1.0)
    assert np.all(np.diff(parts) >= 0.0)
    assert np.diff(parts).max() < 0.05


def test_along_a_corridor_the_prior_decides() -> None:
    truth = Pose2(0.5, -0.1, 0.1)
    cloud = cloud_at(corridor(), truth, np.random.default_rng(2), sigma_m=0.1)
    believed = Pose2(0.9, -0.1, 0.1)
    prior = Prior(target_from_source=believed, information=np.diag([400.0, 400.0, 400.0]))
    target = exact_target(corridor())
    before = icp.align(cloud, target, believed, PARAMS, prior)
    after = icp.polish(cloud, target, before, PARAMS, prior).target_from_source
    assert abs(after.x_m - believed.x_m) < 0.05
    assert abs(after.y_m - truth.y_m) < 0.03


def naive(normals: Array, arms: Array) -> Array:
    lever = normals[:, 1] * arms[:, 0] - normals[:, 0] * arms[:, 1]
    lines = np.column_stack([normals, lever])
    return np.asarray(lines.T @ lines, dtype=np.float64)


def test_noise_of_the_normals_makes_no_information_along_a_corridor() -> None:
    rng = np.random.default_rng(0)
    arms = np.column_stack([rng.uniform(-6.0, 6.0, 400), np.repeat([-1.0, 1.0], 200)])

    def noisy() -> Array:
        turn = math.radians(6.0) * rng.standard_normal(400)
        facing = np.repeat([1.0, -1.0], 200)
        return np.asarray(np.column_stack([-np.sin(turn), np.cos(turn)]) * facing[:, None])

    of_map = noisy()
    found = information.of_points(noisy(), of_map, arms, np.ones(400))
    assert naive(of_map, arms)[0, 0] > 3.0
    assert found[0, 0] < 0.2
    # Across it, and of the heading, nothing is lost.
    assert found[1, 1] > 370.0
    assert found[2, 2] > 0.9 * naive(of_map, arms)[2, 2]
    assert np.all(np.linalg.eigvalsh(found) > 0.0)
    # Without the scan's normals there are only the map's.
    alone = information.of_points(np.zeros((400, 2)), of_map, arms, np.ones(400))
    np.testing.assert_allclose(alone, naive(of_map, arms))
