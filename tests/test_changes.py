from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from labs import cloud_at, exact_target, plain_cloud, room

from amr_slam.changes import Change, compare, sector
from amr_slam.geometry import Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.registration.alignment import Target

MIDDLE = Pose2(4.0, 3.0, 0.5)


def mapped_room() -> Target:
    grown, rng = PointMap(MapParams()), np.random.default_rng(0)
    for x, y in ((2.0, 2.0), (6.0, 2.0), (4.0, 4.0), (4.0, 3.0)):
        grown.insert(cloud_at(room(), Pose2(x, y, 0.3), rng), Pose2(x, y, 0.3))
    return grown.target()


def test_an_unchanged_room_is_explained() -> None:
    cloud = cloud_at(room(), MIDDLE, np.random.default_rng(1), sigma_m=0.01)
    change = compare(cloud, mapped_room(), MIDDLE)
    assert change is not None
    assert change.explained > 0.97
    assert change.contradicting < 0.01


@pytest.mark.parametrize("bearing_deg", [0.0, 90.0, 178.0, -60.0])
def test_people_who_stand_around_contradict_the_map_where_they_stand(bearing_deg: float) -> None:
    ring = math.radians(bearing_deg) + np.linspace(-0.4, 0.4, 7)
    at = 1.5 * np.stack([np.cos(ring), np.sin(ring)], axis=1)
    cloud = cloud_at(room(), MIDDLE, np.random.default_rng(1), people_m=MIDDLE @ at)
    change = compare(cloud, mapped_room(), MIDDLE)
    assert change is not None
    assert 0.05 < change.contradicting < 0.4
    first, last = change.sector_rad
    middle = 0.5 * (first + last)
    assert abs(math.remainder(middle - math.radians(bearing_deg), math.tau)) < 0.25
    assert 0.4 < last - first < 1.4


def test_a_wall_that_is_gone_contradicts_the_map() -> None:
    wide = cloud_at(room(12.0, 6.0), MIDDLE, np.random.default_rng(1))
    change = compare(wide, mapped_room(), MIDDLE)
    assert change is not None
    assert change.contradicting > 0.1
    first, last = change.sector_rad
    ahead = -MIDDLE.theta_rad  # of the wall at x = 8
    assert first < ahead < last
    assert last - first < math.pi


def test_nothing_can_be_said_without_points() -> None:
    empty = plain_cloud(np.empty((0, 2)))
    assert compare(empty, exact_target(room()), MIDDLE) is None
    nowhere = Target(points_m=np.empty((0, 2)), normals=np.empty((0, 2)))
    assert compare(plain_cloud(np.ones((5, 2))), nowhere, MIDDLE) is None


def test_the_sector_is_the_narrowest_one_with_most_of_the_weight() -> None:
    bearings = np.array([-3.0, -2.9, 3.0, 3.1, 0.1, 2.9])
    first, last = sector(bearings, np.ones(6))
    assert (first, last) == pytest.approx((2.9, math.tau - 2.9))
    assert sector(np.array([]), np.array([])) == (0.0, 0.0)
    assert sector(np.array([0.4]), np.array([0.01])) == pytest.approx((0.4, 0.4))
    spread = np.linspace(0.0, 1.0, 50)
    widths = [b - a for a, b in (sector(np.append(spread, t), np.ones(51)) for t in (1.5, 3.0))]
    assert all(a == pytest.approx(b) for a, b in pairwise(widths))  # a stray beam changes nothing


@pytest.mark.parametrize(
    ("sector_deg", "words"),
    [
        ((-20.0, 10.0), "ahead (bearing -20..10 deg)"),
        ((30.0, 60.0), "ahead to the left (bearing 30..60 deg)"),
        ((-100.0, -80.0), "to the right (bearing -100..-80 deg)"),
        ((160.0, 200.0), "behind (bearing 160..200 deg)"),
        ((-170.0, 100.0), "all around"),
    ],
)
def test_where_is_said_in_words(sector_deg: tuple[float, float], words: str) -> None:
    first, last = (math.radians(bearing) for bearing in sector_deg)
    change = Change(explained=0.6, contradicting=0.384, sector_rad=(first, last))
    assert change.describe() == f"38% of the scan contradicts the map, {words}"


def test_a_scan_that_is_explained_to_the_last_point_is_so_by_1_and_not_more() -> None:
    """Eleven equal shares add up to 1 + 2e-16, and a status of more than 1 is no status."""
    y_m = np.linspace(0.5, 5.5, 11)
    cloud = plain_cloud(np.column_stack([np.full(11, 8.0), y_m]), weight=0.3)
    change = compare(cloud, exact_target(room()), Pose2.identity())
    assert change is not None
    assert change.explained == 1.0
