from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.areas import along, area_m2, crossing, inside_of
from amr_slam.geometry import Array

L_SHAPE = np.array([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]], dtype=float)


def star(radii: list[float]) -> Array:
    """A simple polygon around the origin."""
    turns = np.arange(len(radii)) * (math.tau / len(radii))
    corners: Array = np.array(radii)[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
    return corners


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.lists(st.floats(0.5, 5.0), min_size=3, max_size=12), st.integers(0, 2**32 - 1))
def test_a_point_is_inside_where_its_winding_is_one(radii: list[float], seed: int) -> None:
    corners = star(radii)
    points = np.random.default_rng(seed).uniform(-5.0, 5.0, (40, 2))
    spokes = corners - points[:, None]
    angles = np.arctan2(spokes[..., 1], spokes[..., 0])
    turns = np.diff(np.concatenate([angles, angles[:, :1]], axis=1))
    winding = np.sum((turns + math.pi) % math.tau - math.pi, axis=1) / math.tau
    np.testing.assert_array_equal(inside_of(points, corners), np.abs(winding) > 0.5)
    assert crossing(corners) is None


def test_area_of_an_angled_polygon_is_that_of_its_parts() -> None:
    assert math.isclose(area_m2(L_SHAPE + 1000.0), 6.0)
    assert inside_of(np.array([[0.5, 2.5], [2.0, 2.0], [3.5, 0.5]]), L_SHAPE).tolist() == [
        True,
        False,
        True,
    ]


def test_edges_that_meet_are_found() -> None:
    bow = np.array([[0, 0], [2, 2], [2, 0], [0, 2]], dtype=float)
    spike = np.array([[0, 0], [4, 0], [2, 0], [2, 3]], dtype=float)
    touching = np.array([[0, 0], [4, 0], [4, 4], [2, 0], [0, 4]], dtype=float)
    assert crossing(L_SHAPE) is None
    assert crossing(bow) == (0, 2)
    assert crossing(spike) is not None
    assert crossing(touching) is not None


def test_points_along_a_line_are_near_enough_and_normals_stand_on_it() -> None:
    points, normals = along(np.array([[0, 0], [1, 0], [1, 0], [1, 2.2]]), 0.05)
    assert np.hypot(*np.diff(points, axis=0).T).max() <= 0.0501
    assert normals[0].tolist() == [0.0, 1.0]
    assert normals[-1].tolist() == [-1.0, 0.0]
