from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from amr_slam.geometry import Array
from amr_slam.registration.error import e_psr, mean_below, nearest

fixed = settings(derandomize=True, deadline=None, max_examples=100)
coordinates = st.floats(-5.0, 5.0)
clouds = st.lists(st.tuples(coordinates, coordinates), max_size=12).map(
    lambda rows: np.array(rows, dtype=np.float64).reshape(-1, 2)
)


def by_equation_1(X: Array, Y: Array, epsilon: float) -> float:
    d_min = [min((math.dist(x, y) for y in Y), default=math.inf) for x in X]
    below = [d for d in d_min if d < epsilon]
    return sum(below) / len(below) if below else math.inf


@fixed
@given(X=clouds, Y=clouds, epsilon=st.sampled_from([0.3, 1.0, 4.0]))
def test_e_psr_is_equation_1(X: Array, Y: Array, epsilon: float) -> None:
    found = e_psr(X, cKDTree(Y), epsilon)
    assert found == pytest.approx(by_equation_1(X, Y, epsilon), rel=1e-9, abs=1e-12)


def test_the_threshold_itself_does_not_count() -> None:
    tree = cKDTree(np.zeros((1, 2)))
    at, below = np.array([[1.0, 0.0]]), np.array([[math.nextafter(1.0, 0.0), 0.0]])
    assert e_psr(at, tree) == math.inf
    assert e_psr(below, tree) == pytest.approx(1.0)
    assert e_psr(np.concatenate([at, 0.5 * at]), tree) == 0.5


def test_a_subset_of_the_map_is_judged_by_what_both_have() -> None:
    Y = np.random.default_rng(0).uniform(0.0, 20.0, (300, 2))
    assert e_psr(Y[:40], cKDTree(Y)) == 0.0
    far = np.concatenate([Y[:40], np.array([[100.0, 100.0]])])
    assert e_psr(far, cKDTree(Y)) == 0.0


def test_nothing_near_is_infinitely_wrong() -> None:
    empty = np.empty((0, 2))
    some = np.zeros((3, 2))
    assert e_psr(empty, cKDTree(some)) == math.inf
    assert e_psr(some, cKDTree(empty)) == math.inf
    np.testing.assert_array_equal(nearest(some, cKDTree(empty)), [math.inf] * 3)
    assert mean_below(np.array([0.2, math.inf, 0.4])) == pytest.approx(0.3)
