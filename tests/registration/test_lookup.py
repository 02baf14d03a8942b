"""Correspondence in constant time against the exact nearest neighbour."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import exact_target, lab
from scipy.spatial import cKDTree

from amr_slam.geometry import Array
from amr_slam.registration import lookup
from amr_slam.registration.alignment import Target
from amr_slam.registration.lookup import DIRECTIONS, layers_of

NO_NORMAL = np.zeros(2)
fixed = settings(derandomize=True, deadline=None, max_examples=100)


def test_the_row_is_the_nearest_within_one_point_spacing() -> None:
    target = exact_target(lab(0))
    queries = target.points_m[::3] + np.random.default_rng(0).normal(
        0.0, 0.2, target.points_m[::3].shape
    )
    nearest = np.asarray(cKDTree(target.points_m).query(queries)[0])
    row = target.lookup.rows(queries, np.zeros_like(queries))
    found = np.hypot(*(target.points_m[row] - queries).T)
    sure = nearest < target.lookup.reach_m - target.lookup.cell_m
    assert sure.mean() > 0.95
    assert np.all(row[sure] >= 0)
    assert np.all(found[sure] >= nearest[sure] - 1e-12)
    assert np.all(found[sure] <= nearest[sure] + target.spacing_m)
    assert np.mean(found[sure] - nearest[sure]) < 0.1 * target.spacing_m


def test_a_face_finds_the_nearest_of_its_own_side() -> None:
    """A thin board, 2 cm: a query between the faces, or behind one, gets the face it asks for."""
    x = np.arange(0.0, 2.0, 0.05)
    lower = np.column_stack([x, np.zeros_like(x)])
    target = Target(
        points_m=np.concatenate([lower, lower + np.array([0.0, 0.02])]),
        normals=np.repeat([[0.0, -1.0], [0.0, 1.0]], len(x), axis=0),
    )
    queries = np.column_stack([np.linspace(0.1, 1.8, 40), np.full(40, 0.3)])
    for side in (-1.0, 1.0):
        row = target.lookup.rows(queries, np.tile([0.0, side], (40, 1)))
        np.testing.assert_array_equal(target.normals[row, 1], side)
    any_way = target.lookup.rows(queries, np.zeros_like(queries))
    np.testing.assert_array_equal(target.normals[any_way, 1], 1.0)
    sideways = target.lookup.rows(queries, np.tile([1.0, 0.0], (40, 1)))
    np.testing.assert_array_equal(sideways, -1)


def test_points_without_a_normal_are_found_by_those_without_one_only() -> None:
    points = np.random.default_rng(0).uniform(0.0, 3.0, (50, 2))
    target = Target(points_m=points, normals=np.zeros_like(points))
    assert np.all(target.lookup.rows(points, np.zeros_like(points)) >= 0)
    assert np.all(target.lookup.rows(points, np.tile([1.0, 0.0], (50, 1))) == -1)


@fixed
@given(angle=st.floats(-4.0, 4.0), off_deg=st.floats(-24.9, 24.9))
def test_walls_that_face_alike_share_a_layer(angle: float, off_deg: float) -> None:
    """A scan's wall finds a map's wall in the layer it asks, if they agree within 25 degrees."""
    mine, theirs = (
        np.array([math.cos(a), math.sin(a)]) for a in (angle, angle + math.radians(off_deg))
    )
    layer = int(layers_of(mine))
    assert layer > 0
    assert DIRECTIONS[layer] @ mine >= math.cos(math.radians(45.0)) - 1e-12
    assert DIRECTIONS[layer] @ theirs >= lookup._WITHIN


def test_without_a_normal_any_side_is_asked() -> None:
    assert int(layers_of(NO_NORMAL)) == 0


@pytest.mark.parametrize(
    "outside", [[-1e6, 0.0], [1e6, 1e6], [math.nan, 0.0], [0.0, math.inf], [-math.inf, math.nan]]
)
def test_outside_of_the_grid_there_is_nothing(outside: list[float]) -> None:
    target = exact_target(lab(0))
    query = np.array([outside])
    assert target.lookup.rows(query, np.zeros((1, 2)))[0] == -1
    assert not target.lookup.seen_free(query)[0]


def test_free_space_is_where_rays_passed() -> None:
    free = np.array([[1.05, 1.05], [1.15, 1.05], [-0.35, 2.25]])
    walls = np.array([[0.0, 0.0], [3.0, 3.0]])
    target = Target(points_m=walls, normals=np.zeros_like(walls), free_m=free, cell_m=0.1)
    rng = np.random.default_rng(0)
    inside = np.repeat(free, 50, axis=0) + rng.uniform(-0.049, 0.049, (150, 2))
    assert target.lookup.seen_free(inside).all()
    beside = free + np.array([0.0, 0.1])
    assert not target.lookup.seen_free(beside).any()
    assert not target.lookup.seen_free(walls).any()


def test_a_map_torn_apart_over_kilometres_gets_coarser_cells() -> None:
    far: Array = np.array([[0.0, 0.0], [0.5, 0.0], [30e3, 20e3]])
    target = Target(points_m=far, normals=np.zeros_like(far))
    assert target.lookup.cell_m > 1.0
    assert target.lookup.free.size < 40_000_000


def test_more_points_in_a_strip_than_rows_can_tell_are_refused() -> None:
    """Offsets within a tile have 16 bits; wrapped around, they would give wrong walls."""
    crowd = np.column_stack([np.zeros(66_000), np.linspace(0.0, 3000.0, 66_000)])
    target = Target(points_m=crowd, normals=np.zeros_like(crowd))
    with pytest.raises(ValueError, match="too many wall points"):
        _ = target.lookup


def test_no_points_no_lookup() -> None:
    nothing = Target(points_m=np.empty((0, 2)), normals=np.empty((0, 2)))
    with pytest.raises(ValueError, match="no points"):
        _ = nothing.lookup
