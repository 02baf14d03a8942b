"""Thin points move onto the line of their neighbours, and only along it."""

from __future__ import annotations

import numpy as np
import pytest

from amr_slam.geometry import Array
from amr_slam.map import smoothing


def wall(turn: float, offset_m: float, rough_m: float, seed: int) -> Array:
    """Ridges every 5 cm along 6 m of a wall, ``rough_m`` off it, their normals 10 degrees off."""
    rng = np.random.default_rng(seed)
    along = np.arange(-3.0, 3.0, 0.05)
    across = offset_m + rng.normal(0.0, rough_m, len(along))
    normal = turn + 0.5 * np.pi + rng.normal(0.0, 0.17, len(along))
    c, s = np.cos(turn), np.sin(turn)
    x, y = along * c - across * s, along * s + across * c
    mass = rng.uniform(0.5, 1.5, len(along))
    return np.stack([x, y, np.cos(normal), np.sin(normal), mass], axis=1)


def off(rows: Array, turn: float) -> Array:
    return np.asarray(rows[:, 1] * np.cos(turn) - rows[:, 0] * np.sin(turn))


@pytest.mark.parametrize("turn", [0.0, 0.7, 1.57])
def test_a_rough_wall_becomes_straight(turn: float) -> None:
    rough = wall(turn, 0.0, 0.04, 1)
    straight = smoothing.smooth(rough, 0.2)
    assert np.std(off(rough, turn)) > 0.03
    assert np.std(off(straight, turn)[10:-10]) < 0.017
    turned = np.abs(straight[:, 2] * np.cos(turn) + straight[:, 3] * np.sin(turn))
    assert np.sqrt(np.mean(turned[10:-10] ** 2)) < 0.08
    # Normals keep their side; the points' mass is theirs still.
    assert np.all(np.sum(straight[:, 2:4] * rough[:, 2:4], axis=1) > 0.8)
    np.testing.assert_array_equal(straight[:, 4], rough[:, 4])


def test_corners_and_parallel_walls_stay() -> None:
    walls = [wall(0.0, 0.0, 0.0, 2), wall(0.0, 0.3, 0.0, 3), wall(0.5 * np.pi, 1.0, 0.0, 4)]
    straight = smoothing.smooth(np.concatenate(walls), 0.2)
    first, second, third = np.split(straight, 3)
    assert np.abs(off(first, 0.0)).max() < 0.03
    assert np.abs(off(second, 0.0) - 0.3).max() < 0.03
    assert np.abs(off(third, 0.5 * np.pi) - 1.0).max() < 0.03


def test_a_clump_has_less_beside_it_than_a_wall() -> None:
    clump = wall(0.0, 5.0, 0.0, 5)[58:62]
    rows = smoothing.smooth(np.concatenate([wall(0.0, 0.0, 0.01, 6), clump]), 0.25)
    assert rows[-4:, 5].max() < 0.5 * np.median(rows[:-4, 5])


def test_with_no_window_nothing_moves() -> None:
    rough = wall(0.3, 0.0, 0.04, 7)
    same = smoothing.smooth(rough, 0.0)
    np.testing.assert_array_equal(same[:, :5], rough)
    np.testing.assert_array_equal(same[:, 5], rough[:, 4])
    assert smoothing.smooth(rough[:0], 0.2).shape == (0, 6)


def test_the_compiled_loop_and_its_twin_agree() -> None:
    rows = np.concatenate([wall(0.2, 0.0, 0.05, 8), wall(1.2, 0.3, 0.05, 9)])
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    mine, twin = smoothing._moments_loop(rows, 0.15), smoothing._moments_numpy(rows, 0.15)
    np.testing.assert_allclose(mine, twin, rtol=1e-9, atol=1e-12)
