from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from labs import cloud_at, covered_poses, heading_error_rad, lab, mapped_lab

from amr_slam.geometry import Array, Pose2
from amr_slam.registration.rdnm import RdnmParams, as_pose, match, medians, pack, rdn, rdnm, shift

fixed = settings(derandomize=True, deadline=None, max_examples=60)
ORIGIN = np.zeros((1, 2))
sections_of = st.sampled_from([8, 12, 30])
whole_cm = st.integers(-900, 900).map(lambda cm: 0.01 * cm)
clouds = st.lists(st.tuples(whole_cm, whole_cm), max_size=25).map(
    lambda rows: np.array(rows, dtype=np.float64).reshape(-1, 2)
)
viewpoints = st.lists(st.tuples(whole_cm, whole_cm), min_size=1, max_size=3).map(
    lambda rows: np.array(rows, dtype=np.float64) + np.array([0.00417, 0.00283])
)


def by_algorithm_1(X: Array, c: Array, sections: int, epsilon: float, reach: float) -> Array:
    """Procedure RDN, lines 1 to 9, as it is printed; NaN where a section holds no point."""
    alpha = math.tau / sections
    h = np.full(sections, math.nan)
    for i in range(sections):
        section = []
        for x in X:
            angle = math.atan2(x[1] - c[1], x[0] - c[0]) % math.tau
            if i * alpha <= angle < (i + 1) * alpha and math.dist(x, c) <= reach:
                section.append(math.dist(x, c))
        if section:
            layer = [d for d in section if d < min(section) + epsilon]
            h[i] = sum(layer) / len(layer)
    return h


def clear_of_borders(X: Array, views: Array, sections: int) -> Array:
    """The points that single precision puts into the same section, whatever the viewpoint."""
    keep = np.ones(len(X), dtype=np.bool_)
    for c in views:
        position = np.arctan2(X[:, 1] - c[1], X[:, 0] - c[0]) / math.tau * sections
        keep &= np.abs(position - np.round(position)) > 1e-4
    return X[keep]


@fixed
@given(X=clouds, views=viewpoints, sections=sections_of, layer=st.sampled_from([0.3, 1.0, 50.0]))
def test_rdn_is_algorithm_1(X: Array, views: Array, sections: int, layer: float) -> None:
    params = RdnmParams(sections=sections, layer_m=layer, range_max_m=15.0)
    X = clear_of_borders(X, views, sections)
    distance = np.hypot(*np.moveaxis(X[:, None] - views, 2, 0))
    assume(not np.any(np.abs(distance - 15.0) < 1e-4))
    gaps = np.abs(distance[:, None] - distance[None, :])
    assume(not np.any(np.abs(gaps - layer) < 1e-4))
    expected = [by_algorithm_1(X, c, sections, layer, 15.0) for c in views]
    np.testing.assert_allclose(rdn(X, views, 0.0, params), expected, rtol=1e-5)


def test_near_walls_have_no_gaps() -> None:
    """A round wall of points 5 cm apart: near, sections fall between the points."""
    params = RdnmParams(sections=120)
    angles = np.arange(50) * (math.tau / 50)
    wall = 0.4 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert np.isnan(rdn(wall, ORIGIN, 0.0, params)).any()
    np.testing.assert_allclose(rdn(wall, ORIGIN, 0.06, params), 0.4, rtol=1e-5)
    far = 30.0 * wall
    np.testing.assert_allclose(
        rdn(far, ORIGIN, 0.06, params), rdn(far, ORIGIN, 0.0, params), equal_nan=True
    )


@fixed
@given(n=st.integers(2, 12), r=st.integers(0, 30))
def test_shift_is_the_matrix_of_equation_2(n: int, r: int) -> None:
    r %= n
    S = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            S[i, j] = 1.0 if j in {i + r, i + r - n} else 0.0
    h = np.arange(n, dtype=np.float64) ** 2
    np.testing.assert_array_equal(shift(h, r), S @ h)


components = st.one_of(st.floats(0.1, 20.0), st.just(math.nan))


@fixed
@given(data=st.data(), candidates=st.integers(1, 4))
def test_match_is_line_16_for_all_rotations(data: st.DataObject, candidates: int) -> None:
    row = st.lists(components, min_size=8, max_size=8)
    h_x = np.array(data.draw(row))
    h_y = np.array(data.draw(st.lists(row, min_size=candidates, max_size=candidates)))
    params = RdnmParams(sections=8, shorter_m=0.7, longer_m=1.9, unseen_m=0.4)
    expected = np.full((candidates, 8), math.inf)
    for p in range(candidates):
        for r in range(8):
            turned = shift(h_y[p], r)
            costs = []
            for mine, theirs in zip(h_x, turned, strict=True):
                if math.isnan(mine):
                    continue
                if math.isnan(theirs):
                    costs.append(0.4)
                elif mine < theirs:
                    costs.append(min(theirs - mine, 0.7))
                else:
                    costs.append(min(mine - theirs, 1.9))
            if costs:
                expected[p, r] = sum(costs) / len(costs)
    np.testing.assert_allclose(match(h_x, pack(h_y), params), expected, atol=6e-4)


def test_a_turn_of_the_robot_is_a_shift() -> None:
    """Turned by r sections, the scan matches the map at column r, and nowhere better."""
    params = RdnmParams(sections=60)
    rng = np.random.default_rng(0)
    walls = rng.uniform(-6.0, 6.0, (150, 2))
    h_y = pack(rdn(walls, ORIGIN, 0.0, params))
    for r in (0, 1, 17, 59):
        seen = Pose2(0.0, 0.0, r * math.tau / 60 + 1e-4).inverse() @ walls
        costs = match(rdn(seen, ORIGIN, 0.0, params)[0], h_y, params)
        assert int(np.argmin(costs)) == r
        assert costs[0, r] < 0.1


def test_results_are_the_cheapest_of_all_candidates_and_rotations() -> None:
    params = RdnmParams(sections=24, rotations=3)
    rng = np.random.default_rng(1)
    h_x, h_y = rng.uniform(1.0, 3.0, 24), pack(rng.uniform(1.0, 3.0, (7, 24)))
    places = rng.uniform(-5.0, 5.0, (7, 2))
    costs = match(h_x, h_y, params)
    rough = rdnm(h_x, h_y, places, params, best=5)
    assert rough.shape == (5, 4)
    assert np.all(np.diff(rough[:, 3]) >= 0.0)
    p, r = np.unravel_index(int(np.argmin(costs)), costs.shape)
    np.testing.assert_allclose(rough[0], [*places[p], r * math.tau / 24, costs[p, r]])
    everything = rdnm(h_x, h_y, places, params, best=1000)
    assert len(everything) == 7 * 3
    _, kept = np.unique(everything[:, 0], return_counts=True)
    np.testing.assert_array_equal(kept, 3)
    assert as_pose(rough[0]) == Pose2.from_array(rough[0, :3])


def test_a_heading_limits_the_rotations() -> None:
    params = RdnmParams(sections=36, rotations=4)
    rng = np.random.default_rng(2)
    h_x, h_y = rng.uniform(1.0, 3.0, 36), pack(rng.uniform(1.0, 3.0, (5, 36)))
    places = rng.uniform(-5.0, 5.0, (5, 2))
    for centre in (0.3, 3.1, -3.1):
        rough = rdnm(h_x, h_y, places, params, best=100, heading=(centre, 0.5))
        off = np.abs([math.remainder(theta - centre, math.tau) for theta in rough[:, 2]])
        assert len(rough) == 20
        assert off.max() <= 0.5
    # Narrower than a section: the nearest rotation stays.
    narrow = rdnm(h_x, h_y, places, params, best=100, heading=(0.3, 0.001))
    np.testing.assert_allclose(narrow[:, 2], math.radians(20.0))


def test_nothing_seen_or_nowhere_to_look_gives_nothing() -> None:
    params = RdnmParams(sections=8)
    blind = np.full(8, math.nan)
    some = pack(np.ones((3, 8)))
    assert rdn(np.empty((0, 2)), np.zeros((2, 2)), 0.05, params).shape == (2, 8)
    assert np.isinf(match(blind, some, params)).all()
    assert rdnm(blind, some, np.zeros((3, 2)), params, best=5).shape == (0, 4)
    assert rdnm(np.ones(8), pack(np.empty((0, 8))), np.empty((0, 2)), params).shape == (0, 4)


@pytest.mark.parametrize("seed", [0, 1])
def test_rdnm_finds_the_pose_of_a_scan(seed: int) -> None:
    """Within the grid's spacing and two sections, by the cheapest of all candidates."""
    params, grid_m = RdnmParams(), 0.5
    grown, rng = mapped_lab(seed), np.random.default_rng(seed)
    places, h_y = grown.signatures(grid_m, 0.3, params)
    found, among_the_best = 0, 0
    truth = list(covered_poses(seed, 8))
    for pose in truth:
        cloud = cloud_at(lab(seed), pose, rng, sigma_m=0.01)
        rough = rdnm(medians(cloud.points_m, params), h_y, places, params, best=24)
        right = [
            as_pose(row).distance_to(pose) < math.hypot(grid_m, grid_m)
            and heading_error_rad(as_pose(row), pose) < 2.0 * math.tau / params.sections
            for row in rough
        ]
        found += right[0]
        among_the_best += any(right)
    assert among_the_best == len(truth)
    assert found >= len(truth) - 1
