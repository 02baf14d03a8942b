"""The search around a pose that somebody names, on simulated rooms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from labs import cloud_at, corridor, lab, mapped_lab, room, tour_poses, world_of

from amr_slam.engine import SlamEngine
from amr_slam.evidence import Rung, Verdict
from amr_slam.geometry import Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.params import SlamParams
from amr_slam.region import Region, slam_region
from amr_slam.slam_request import SlamRequest

PARAMS = SlamParams()


def region_at(pose: Pose2, radius_m: float = 1.5, heading_deg: float = 60.0) -> Region:
    return Region(map_from_base=pose, radius_m=radius_m, heading_rad=math.radians(heading_deg))


@pytest.mark.parametrize("step", [3, 11])
def test_the_pose_is_found_where_somebody_says_it_is_about(step: int) -> None:
    rng = np.random.default_rng(step)
    truth = tour_poses(0)[step]
    cloud = cloud_at(lab(0), truth, rng, sigma_m=0.01)
    named = truth @ Pose2(0.9, -0.7, math.radians(40.0))
    engine = SlamEngine(PARAMS, mapped_lab(0), "localization")
    request = SlamRequest(
        cloud=cloud,
        map_from_base=Pose2(-5.0, 9.0, 1.0),  # whatever the fusion thinks
        covariance=np.diag([1e-4, 1e-4, 1e-6]),
        region=region_at(named),
    )
    result = engine.update(request)
    assert result.sought
    assert result.answer.rung is Rung.REGION
    assert result.fix is not None, result.answer.reason
    assert result.fix.relocalized
    assert result.fix.map_from_base.distance_to(truth) < 0.05


@pytest.mark.parametrize(
    "off",
    [Pose2(4.0, 0.0, 0.0), Pose2(-3.5, 2.0, 0.3), Pose2(0.0, 0.0, math.pi)],
    ids=["4 m off", "another corner", "turned around"],
)
def test_a_place_where_the_robot_is_not_is_refused_with_a_reason(off: Pose2) -> None:
    truth = tour_poses(0)[3]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    answers = list(slam_region(cloud, mapped_lab(0), region_at(truth @ off), PARAMS))
    assert answers[-1].verdict is not Verdict.ACCEPTED
    assert answers[-1].reason


def two_rooms(box_m: float) -> tuple[PointMap, Pose2]:
    """A bare room, and 30 m beside it another one of its size with a box in a corner; and where
    in the second one its twin of the first one's origin lies."""
    second = Pose2(30.0, 0.0, 0.0)
    box = [[8 - box_m, 0, 8 - box_m, box_m], [8 - box_m, box_m, 8, box_m]]
    walls = np.array([*room().segments_m.tolist(), *box])
    walls[:, ::2] += second.x_m
    known, rng = PointMap(MapParams()), np.random.default_rng(0)
    for x_m, y_m in ((2.0, 2.0), (3.0, 4.0), (4.0, 3.0), (5.0, 4.0)):
        pose = Pose2(x_m, y_m, 0.3)
        known.insert(cloud_at(room(), pose, rng), pose)
        known.insert(cloud_at(world_of(walls), second @ pose, rng), second @ pose)
    return known, second


@pytest.mark.parametrize(("box_m", "believed"), [(0.0, True), (2.0, False)])
def test_among_places_that_look_alike_the_word_decides_but_not_against_a_better_one(
    box_m: float, believed: bool
) -> None:
    known, second = two_rooms(box_m)
    here = Pose2(4.2, 3.1, 0.4)
    cloud = cloud_at(room(), here, np.random.default_rng(1), sigma_m=0.01)
    answers = list(slam_region(cloud, known, region_at(second @ here), PARAMS))
    assert answers[0].verdict is Verdict.ACCEPTED, answers[0].reason
    assert (answers[-1].verdict is Verdict.ACCEPTED) is believed
    if not believed:
        assert "fits better outside the region, at x 4." in (answers[-1].reason or "")


def test_no_map_and_no_walls_in_view_are_refused() -> None:
    cloud = cloud_at(lab(0), tour_poses(0)[3], np.random.default_rng(0), sigma_m=0.01)
    empty = PointMap(MapParams())
    (answer,) = slam_region(cloud, empty, region_at(Pose2.identity()), PARAMS)
    assert (answer.verdict, answer.reason) == (Verdict.UNKNOWN, "the map is empty")


def test_a_corridor_that_looks_the_same_all_along_confirms_no_place() -> None:
    rng = np.random.default_rng(0)
    world, known = corridor(), PointMap(MapParams())
    for x_m in np.arange(-10.0, 10.0, 1.0):
        known.insert(cloud_at(world, Pose2(x_m, 0.0, 0.0), rng), Pose2(x_m, 0.0, 0.0))
    cloud = cloud_at(world, Pose2(0.0, 0.0, 0.0), rng, sigma_m=0.01)
    *_, answer = slam_region(cloud, known, region_at(Pose2(2.0, 0.0, 0.0), 3.0), PARAMS)
    assert answer.verdict is not Verdict.ACCEPTED


def test_the_quick_search_alone_does_when_the_thorough_one_is_off() -> None:
    truth = tour_poses(0)[3]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    quick = replace(PARAMS, exhaustive=replace(PARAMS.exhaustive, candidates=0))
    named = truth @ Pose2(0.9, -0.7, math.radians(40.0))
    *_, answer = slam_region(cloud, mapped_lab(0), region_at(named), quick)
    assert answer.verdict is Verdict.ACCEPTED
    assert answer.best is not None
    assert answer.best.pose.distance_to(truth) < 0.05
