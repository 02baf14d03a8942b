"""The compiled loops and their numpy twins say the same."""

from __future__ import annotations

import numpy as np
import pytest

from amr_slam.map import kernels, strokes
from amr_slam.map.grid import SparseGrid
from amr_slam.map.kernels import gaussian


def image(seed: int, rows: int = 37, columns: int = 52) -> kernels.Image:
    values = np.random.default_rng(seed).random((rows, columns))
    return np.where(values > 0.7, values, 0.0).astype(np.float32)


@pytest.mark.parametrize("sigma", [0.3, 1.3, 6.0, 30.0])
def test_blurs_agree_and_keep_the_mass(sigma: float) -> None:
    taps = gaussian(sigma)
    mine, twin = kernels._blur_loop(image(0), taps), kernels._blur_numpy(image(0), taps)
    np.testing.assert_allclose(mine, twin, rtol=1e-6)
    spot = np.zeros((61, 81), dtype=np.float32)
    spot[30, 40] = 1.0
    if sigma < 10.0:
        blurred = kernels.blur(spot, taps)
        assert float(blurred.sum()) == pytest.approx(1.0, abs=1e-4)
        row, column = np.indices(spot.shape)
        assert float(np.sum(blurred * column)) == pytest.approx(40.0, abs=0.02)
        assert float(np.sum(blurred * row)) == pytest.approx(30.0, abs=0.02)


def test_the_cells_that_rays_pass_agree_and_leave_out_where_any_ended() -> None:
    rng, grid = np.random.default_rng(3), SparseGrid(0.1, 2)
    angles = np.linspace(-2.3, 2.3, 300)
    origins = np.tile([3.33, -7.21], (300, 1))
    ends = origins + rng.uniform(0.1, 9.0, (300, 1)) * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    )
    low = np.floor(np.concatenate([ends, origins]).min(axis=0) / 0.1) - 1.0
    mine, twin = np.zeros((2, 200, 200), dtype=np.bool_)
    strokes._mark_loop(ends, origins, 0.2, 0.1, low, mine)
    strokes._mark_numpy(ends, origins, 0.2, 0.1, low, twin)
    np.testing.assert_array_equal(mine, twin)
    passed, ended = strokes.carved(ends, origins, 0.2, grid)
    assert not np.isin(ended, passed).any()
    # On every ray that is long enough, the middle was passed, or another one ended there.
    far = np.hypot(*(ends - origins).T) > 0.5
    middles = grid.keys_of(0.5 * (ends + origins)[far])
    assert np.mean(np.isin(middles, np.concatenate([passed, ended]))) > 0.85
    assert len(passed) == len(np.unique(passed)) > 1000


def test_climbs_agree_at_the_edges_and_outside_too() -> None:
    rng = np.random.default_rng(1)
    starts = rng.uniform([-5.0, -5.0], [57.0, 42.0], (200, 2))
    smooth = kernels.blur(image(2), gaussian(1.0))  # on speckles a last digit decides the way
    mine = kernels._climb_loop(smooth, starts, 1.7, 3)
    twin = kernels._climb_numpy(smooth, starts, 1.7, 3)
    found = mine[:, 4] > 0.0
    np.testing.assert_array_equal(found, twin[:, 4] > 0.0)
    assert 0.7 < found.mean() < 1.0
    np.testing.assert_allclose(mine, twin, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.4])
def test_a_ridge_is_climbed(turn: float) -> None:
    row, column = np.indices((60, 60))
    off = (column - 30.0) * -np.sin(turn) + (row - 30.0) * np.cos(turn)
    ridge = np.exp(-0.5 * (off / 2.0) ** 2).astype(np.float32)
    starts = np.column_stack([np.arange(22.0, 39.0), 30.0 + (np.arange(17.0) - 8.0) * np.tan(turn)])
    starts = np.clip(starts, 15.0, 45.0)
    off_before = (starts[:, 0] - 30.0) * -np.sin(turn) + (starts[:, 1] - 30.0) * np.cos(turn)
    starts = starts[np.abs(off_before) < 3.0] + np.array([0.0, 1.5])
    found = kernels.climb(ridge, starts, 2.0, 8)
    off_after = (found[:, 0] - 30.0) * -np.sin(turn) + (found[:, 1] - 30.0) * np.cos(turn)
    assert np.abs(off_after).max() < 0.05
    assert np.abs(found[:, 2] * np.cos(turn) + found[:, 3] * np.sin(turn)).max() < 0.05
