"""How far the walls are along a ray: against exact geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import exact_target, lab, room, tour_poses, world_of

from amr_slam.geometry import Array
from amr_slam.registration.alignment import Target
from amr_slam.registration.casting import ranges
from amr_slam.simulation.casting import to_all_segments

fixed = settings(derandomize=True, deadline=None, max_examples=60)
ROOM = exact_target(room())
DOOR = exact_target(world_of(np.array([[2.0, -3.0, 2.0, -0.5], [2.0, 0.5, 2.0, 3.0]])))


def around(count: int) -> Array:
    angles = (np.arange(count) + 0.37) * (math.tau / count)
    return np.column_stack([np.cos(angles), np.sin(angles)])


@fixed
@given(x=st.floats(0.3, 7.7), y=st.floats(0.3, 5.7))
def test_in_a_bare_room_every_range_is_exact(x: float, y: float) -> None:
    """Within the walls' thickness of 6 cm: along the ray where it meets them at 30 degrees or
    more, across the wall where it grazes them."""
    directions = around(45)
    with np.errstate(divide="ignore"):
        to_x = np.where(directions[:, 0] > 0.0, 8.0 - x, -x) / directions[:, 0]
        to_y = np.where(directions[:, 1] > 0.0, 6.0 - y, -y) / directions[:, 1]
    exact = np.minimum(to_x, to_y)
    across = np.abs(np.where(to_x < to_y, directions[:, 0], directions[:, 1]))
    corner = np.abs(to_x - to_y) * np.abs(directions).min(axis=1) < 0.15
    short = (exact - ranges(ROOM, np.tile([x, y], (45, 1)), directions, 20.0))[~corner]
    across = across[~corner]
    assert np.all(np.abs(short[across >= 0.5]) < 0.06)
    assert np.all(short * across < 0.06)
    assert np.all(short > -0.01)
    assert np.median(np.abs(short)) < 1e-6  # the wall's line, not its nearest point


@pytest.mark.parametrize("place", [5, 25, 45])
def test_in_a_furnished_laboratory_nothing_is_passed(place: int) -> None:
    """A ray that grazes an edge within 6 cm meets it; none goes through a wall, and each ends
    at one."""
    world = lab(0)
    target = exact_target(world)
    directions = around(360)
    origins = np.tile(tour_poses(0)[place].translation, (360, 1))
    exact = to_all_segments(origins, directions, world.segments_m)
    found = ranges(target, origins, directions, 30.0)
    assert np.all(found < exact + 0.06)
    assert np.mean(found > exact - 0.06) > 0.8
    to_wall = target.tree.query(origins + found[:, None] * directions)[0]
    assert np.all(to_wall <= 0.12)  # met within 6 cm of a point, and moved by 6 cm at most


def test_rays_pass_where_there_is_no_wall() -> None:
    origins = np.column_stack([np.zeros(9), np.linspace(-0.4, 0.4, 9)])
    ahead = np.tile([1.0, 0.0], (9, 1))
    assert np.isinf(ranges(DOOR, origins, ahead, 20.0)).all()
    beside = origins + np.array([0.0, 1.2])
    np.testing.assert_allclose(ranges(DOOR, beside, ahead, 20.0), 2.0, atol=1e-6)
    assert np.isinf(ranges(DOOR, beside, -ahead, 20.0)).all()


def test_a_gap_between_two_points_of_a_wall_is_closed() -> None:
    """Whatever lies between two points 5 cm apart, near or far, straight or oblique."""
    rng = np.random.default_rng(0)
    ends = np.column_stack([np.full(300, 2.0), rng.uniform(0.6, 2.9, 300)])
    origins = np.column_stack([rng.uniform(-6.0, 1.5, 300), rng.uniform(-1.0, 4.0, 300)])
    reach = np.hypot(*(ends - origins).T)
    found = ranges(DOOR, origins, (ends - origins) / reach[:, None], 20.0)
    np.testing.assert_allclose(found, reach, atol=0.06 / math.sin(math.radians(10.0)))
    assert np.mean(np.abs(found - reach) < 0.06) > 0.9


def test_a_wall_beyond_the_range_is_none() -> None:
    ahead = np.array([[1.0, 0.0]])
    start = np.array([[0.0, 1.0]])
    assert np.isinf(ranges(DOOR, start, ahead, 1.5))[0]
    assert ranges(DOOR, start, ahead, 2.5)[0] == pytest.approx(2.0, abs=1e-6)


def test_from_far_outside_the_walls_are_met_too() -> None:
    start, ahead = np.array([[-40.0, 3.0]]), np.array([[1.0, 0.0]])
    assert ranges(ROOM, start, ahead, 100.0)[0] == pytest.approx(40.0, abs=0.06)


def test_from_a_wall_the_range_is_nothing() -> None:
    start = np.array([[8.0, 3.0]])
    assert ranges(ROOM, start, np.array([[1.0, 0.0]]), 5.0)[0] == pytest.approx(0.0, abs=0.06)


def test_nothing_to_meet() -> None:
    nothing = Target(points_m=np.empty((0, 2)), normals=np.empty((0, 2)))
    assert np.isinf(ranges(nothing, np.zeros((3, 2)), around(3), 10.0)).all()
    assert ranges(ROOM, np.empty((0, 2)), np.empty((0, 2)), 10.0).shape == (0,)
    bad = np.array([[math.nan, 1.0], [math.inf, 0.0]])
    assert np.isinf(ranges(ROOM, bad, around(2), 10.0)).all()
