"""Found, ambiguous, lost, changed: the whole chain from beams to state, in worlds that repeat."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from labs import cloud_at, lab, mapped_lab, plain_cloud, room, tour_poses, world_of
from locating import (
    HALF_TURN,
    ROUND_THE_ROOM,
    THROUGH_THE_DOOR,
    Driven,
    Moment,
    twin_map,
    twin_rooms,
)

from amr_slam.clouds import Cloud
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.samples import State
from amr_slam.simulation import World
from amr_slam.slam_request import SlamRequest

BEGIN = Pose2(-7.5, 2.5, 0.0)
RIGHT_M = 0.25


@functools.cache
def twins() -> tuple[World, PointMap]:
    return twin_rooms(), twin_map(twin_rooms())


def assert_never_wrong(moments: list[Moment]) -> None:
    assert moments
    for moment in moments:
        assert moment.said.state is not State.LOCALIZED or moment.off_m < RIGHT_M


def test_in_a_room_that_exists_twice_the_robot_names_both_until_it_has_left_it() -> None:
    driven = Driven(*twins(), BEGIN)
    moments = list(driven.along(ROUND_THE_ROOM))
    assert {moment.said.state for moment in moments} == {State.AMBIGUOUS}
    for moment in moments[1:]:
        here, there = moment.said.candidates[:2]
        truth, twin = moment.truth, HALF_TURN @ moment.truth
        off = [one.map_from_base.distance_to(truth) for one in (here, there)]
        assert min(off) < 0.1
        assert [here, there][int(np.argmax(off))].map_from_base.distance_to(twin) < 0.1
        assert max(here.odds, there.odds) < 0.99
    beyond = list(driven.along(THROUGH_THE_DOOR[len(ROUND_THE_ROOM) :]))
    assert_never_wrong(beyond)
    assert beyond[-1].said.state is State.LOCALIZED
    assert beyond[-1].said.epoch == 1
    assert beyond[-1].said.candidates == ()


def test_where_nothing_tells_the_ends_apart_the_robot_never_claims_one() -> None:
    alike = twin_rooms(told_apart=False)
    driven = Driven(alike, twin_map(alike), BEGIN)
    states = {moment.said.state for moment in driven.along(((-5.2, 2.6), (-5, 0), (-1.0, -0.2)))}
    assert states == {State.AMBIGUOUS}


def test_a_standing_robot_sees_the_same_thing_again_and_again() -> None:
    driven = Driven(*twins(), BEGIN)
    moments = list(driven.stand(16.0))
    assert len(moments) >= 7
    assert {moment.said.state for moment in moments} == {State.AMBIGUOUS}


def test_a_robot_that_was_carried_away_finds_itself_again() -> None:
    world, known = lab(3), mapped_lab(3)
    first, there = (tour_poses(3)[k] for k in (0, len(tour_poses(3)) // 2))
    driven = Driven(world, known, first, start=first)
    moments = list(driven.stand(4.0))
    assert moments[-1].said.state is State.LOCALIZED
    driven.carry_to(there)
    ahead = [(pose.x_m, pose.y_m) for pose in tour_poses(3)[len(tour_poses(3)) // 2 + 1 :]][:14]
    moments = list(driven.along(ahead))
    assert moments[-1].said.state is State.LOCALIZED
    assert moments[-1].said.epoch == 1
    assert moments[-1].off_m < 0.1
    jumped = next(k for k, moment in enumerate(moments) if moment.said.epoch == 1)
    assert 1 <= jumped <= 5  # not for one scan; nor much later
    assert_never_wrong(moments[jumped:])


def test_a_robot_in_another_building_is_never_located() -> None:
    known = mapped_lab(3)
    begin = tour_poses(5)[0]
    driven = Driven(lab(5), known, begin)
    states = {
        moment.said.state
        for moment in driven.along([(pose.x_m, pose.y_m) for pose in tour_poses(5)[1:16]])
    }
    assert states <= {State.LOST, State.AMBIGUOUS}


def test_moved_furniture_is_told_and_the_robot_stays_where_it_is() -> None:
    world, known = twins()
    shelves = np.array([[-9.5, 1.6, -4.5, 1.6], [-4.5, 1.6, -4.5, 2.0], [-9.5, 1.6, -9.5, 2.0]])
    furnished = world_of(np.concatenate([world.segments_m, shelves]))
    begin = Pose2(-9.0, 0.9, 0.0)
    driven = Driven(furnished, known, begin, start=begin)
    moments = list(driven.along([(-6.8, 1.0)]))
    assert {moment.said.state for moment in moments} == {State.LOCALIZED}
    assert max(moment.off_m for moment in moments) < 0.05
    faults = [str(moment.said.fault) for moment in moments]
    assert any("changed?" in fault and "left" in fault for fault in faults), faults
    assert all("right" not in fault for fault in faults)
    assert all(0.3 < (moment.said.explained or 0.0) < 0.9 for moment in moments)


def one_wall() -> Cloud:
    y = np.linspace(-2.0, 2.0, 80)
    points = np.column_stack([np.full(80, 1.5), y])
    return plain_cloud(points, np.tile([-1.0, 0.0], (80, 1)))


@pytest.mark.parametrize(
    "cloud",
    [
        plain_cloud(np.empty((0, 2))),
        plain_cloud(np.array([[1.0, 0.0], [1.0, 0.1], [0.0, 2.0]])),
        one_wall(),
    ],
    ids=["empty", "three points", "one wall"],
)
@pytest.mark.parametrize("located", [False, True])
def test_a_scan_that_says_too_little_is_unknown_with_its_reason(
    cloud: Cloud, located: bool
) -> None:
    engine = SlamEngine(SlamParams(), twins()[1], "localization")
    result = engine.update(
        SlamRequest(
            cloud=cloud,
            map_from_base=None,
            covariance=None,
            also=np.array([BEGIN.as_array()]) if located else None,
        )
    )
    assert result.fix is None
    assert result.answer.reason


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, 0.0, -1.0, 1e30], ids=["nan", "inf", "zero", "negative", "huge"]
)
def test_readings_that_are_none_locate_nobody(value: float) -> None:
    driven = Driven(room(), PointMap(SlamParams().map), Pose2(4.0, 3.0, 0.0))
    driven.engine.map.insert(
        cloud_at(room(), Pose2(4.0, 3.0, 0.0), np.random.default_rng(0)), Pose2(4.0, 3.0, 0.0)
    )
    said = driven.stand_blind(6.0, value)
    assert len(said) >= 2
    assert {one.state for one in said} == {State.LOST}
    assert all(one.fault for one in said)
