from __future__ import annotations

import math

import numpy as np
import pytest

from amr_slam.geometry import Array, Pose2
from amr_slam.map.thinning import thin_walls


def band(length_m: float, sigma_m: float, turn_rad: float, seed: int) -> tuple[Array, Array]:
    """A noisy wall through the origin, seen from its left side: points and sights."""
    rng = np.random.default_rng(seed)
    count = round(400 * length_m)
    flat = np.column_stack(
        [rng.uniform(-0.5 * length_m, 0.5 * length_m, count), rng.normal(0.0, sigma_m, count)]
    )
    frame = Pose2(0.0, 0.0, turn_rad)
    return frame @ flat, np.tile(frame @ np.array([[0.0, 1.0]]), (count, 1))


@pytest.mark.parametrize("sigma", [0.03, 0.1, 0.2])
@pytest.mark.parametrize("turn", [0.0, 0.7, 2.0])
def test_a_noisy_band_becomes_a_line(sigma: float, turn: float) -> None:
    points, sights = band(8.0, sigma, turn, 0)
    thin, normals = thin_walls(points, np.ones(len(points)), sights, sigma, 0.05)
    frame = Pose2(0.0, 0.0, turn)
    flat = frame.inverse() @ thin
    inner = np.abs(flat[:, 0]) < 3.5
    assert inner.sum() > 7.0 / 0.05 * 0.7
    assert math.sqrt(float(np.mean(flat[inner, 1] ** 2))) < 0.3 * sigma
    across = normals[inner] @ frame.rotation
    assert math.sqrt(float(np.mean(np.arctan2(across[:, 0], across[:, 1]) ** 2))) < 0.15
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_normals_face_where_the_wall_was_seen_from() -> None:
    points, sights = band(6.0, 0.05, 0.3, 1)
    ones = np.ones(len(points))
    left, normals = thin_walls(points, ones, sights, 0.05, 0.05)
    other, away = thin_walls(points, ones, -sights, 0.05, 0.05)
    np.testing.assert_allclose(left, other)
    np.testing.assert_allclose(normals, -away)
    assert np.mean(normals @ sights[0] > 0.9) > 0.95


def test_two_walls_stay_two() -> None:
    near, sights = band(6.0, 0.05, 0.0, 2)
    far = near + np.array([0.0, 1.0])
    points = np.concatenate([near, far])
    thin, _ = thin_walls(points, np.ones(len(points)), np.tile(sights, (2, 1)), 0.05, 0.05)
    inner = np.abs(thin[:, 0]) < 2.5
    off = np.minimum(np.abs(thin[inner, 1]), np.abs(thin[inner, 1] - 1.0))
    assert np.percentile(off, 95) < 0.03
    assert np.sum(thin[inner, 1] > 0.5) == pytest.approx(np.sum(inner) / 2, rel=0.1)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_hardly_any_points_are_survived(count: int) -> None:
    points = np.arange(2.0 * count).reshape(-1, 2)
    thin, normals = thin_walls(points, np.ones(count), np.ones((count, 2)), 0.1, 0.05)
    assert thin.shape == normals.shape == (count, 2)
    assert np.all(np.isfinite(thin))
