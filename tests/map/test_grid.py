from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.geometry import Array
from amr_slam.map.grid import SparseGrid

fixed = settings(derandomize=True, deadline=None, max_examples=100)
coordinate = st.one_of(st.floats(-3.0, 3.0), st.floats(-1e6, 1e6))
rows = st.lists(st.tuples(coordinate, coordinate, st.integers(-50, 50)), max_size=15)
batches = st.lists(rows, min_size=1, max_size=4)


def as_arrays(batch: list[tuple[float, float, int]]) -> tuple[Array, Array]:
    table = np.array(batch, dtype=np.float64).reshape(-1, 3)
    return table[:, :2], np.column_stack([np.ones(len(table)), table[:, 2]])


@fixed
@given(batches=batches, cell=st.sampled_from([0.05, 0.5, 1.0]))
def test_the_grid_is_a_dictionary_of_sums(
    batches: list[list[tuple[float, float, int]]], cell: float
) -> None:
    grid = SparseGrid(cell, 2)
    sums: dict[tuple[int, int], list[float]] = {}
    for batch in batches:
        points, values = as_arrays(batch)
        grid.add(grid.keys_of(points), values)
        for (x, y), value in zip(points, values, strict=True):
            entry = sums.setdefault((math.floor(x / cell), math.floor(y / cell)), [0.0, 0.0])
            entry[0] += value[0]
            entry[1] += value[1]
    assert len(grid) == len(sums)
    assert np.all(np.diff(grid.keys) > 0)
    centres = np.array([((ix + 0.5) * cell, (iy + 0.5) * cell) for ix, iy in sums]).reshape(-1, 2)
    found = grid.find(grid.keys_of(centres))
    assert np.all(found >= 0)
    np.testing.assert_allclose(grid.sums[found], np.array(list(sums.values())).reshape(-1, 2))
    np.testing.assert_allclose(grid.centres()[found], centres, rtol=1e-9, atol=1e-9)
    elsewhere = grid.keys_of(centres + np.array([2e6, 0.0]))
    np.testing.assert_array_equal(grid.find(elsewhere), -1)


def test_an_empty_grid_finds_nothing() -> None:
    grid = SparseGrid(0.1, 3)
    keys = grid.keys_of(np.zeros((4, 2)))
    np.testing.assert_array_equal(grid.find(keys), [-1] * 4)
    grid.add(keys[:0], np.empty((0, 3)))
    assert len(grid) == 0
    assert grid.centres().shape == (0, 2)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e12, -1e12])
def test_points_beyond_the_grid_are_refused(bad: float) -> None:
    """Not wrapped into another place."""
    with pytest.raises(ValueError, match="outside the grid"):
        SparseGrid(0.1, 1).keys_of(np.array([[0.0, 0.0], [0.0, bad]]))
