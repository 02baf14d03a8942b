"""A world of two identical rooms: what the report says of its map is true in the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from labs import cloud_at
from locating import PARAMS, map_of, twin_rooms

from amr_slam.commissioning import Report, ReportParams, make_report, usual_eyes
from amr_slam.commissioning.about import About
from amr_slam.commissioning.cold_starts import ColdStart, Outcome, Switchboard
from amr_slam.commissioning.look_alikes import pairs
from amr_slam.commissioning.machine import facts
from amr_slam.commissioning.page import page
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.simulation import World
from amr_slam.simulation.shapes import edges
from amr_slam.slam_request import SlamRequest

SCANS = [
    *((x, y) for x in (-9.0, -7.0, -5.0) for y in (-1.4, 1.0, 2.2)),
    *((x, 0.0) for x in (-5.0, -3.0, -1.0, 0.5)),
]
BOTH = [*SCANS, *((-x, -y) for x, y in SCANS)]


@pytest.fixture(scope="module")
def world() -> World:
    return twin_rooms(told_apart=False)


@pytest.fixture(scope="module")
def report(world: World) -> Report:
    params = ReportParams(
        cold_starts=24, suspects=6, precision_places=12, boxes_tried=2, poses_a_box=6, pairs_tried=1
    )
    return make_report(map_of(world, BOTH), usual_eyes(), PARAMS, params, lambda *_: None)


def in_the_world(world: World, known: PointMap, report: Report, one: ColdStart) -> ColdStart:
    """The same cold start with scans of the world, which the report never saw."""
    engine, rng = SlamEngine(PARAMS, known, "localization"), np.random.default_rng(3)
    cloud = cloud_at(world, one.truth, rng, sigma_m=0.01)
    answer = engine.update(SlamRequest(cloud=cloud, map_from_base=None, covariance=None)).answer
    board = Switchboard(known, report.eyes, PARAMS, report.params)
    return board.judged(answer, one.truth, even=one.even)


def test_what_is_called_alike_is_ambiguous_in_the_world(world: World, report: Report) -> None:
    (pair, *_) = report.pairs
    assert len(pair.confused) >= 12
    # Half a turn about the origin takes one room into the other.
    np.testing.assert_allclose(pair.there_m, -pair.here_m, atol=0.1)
    assert min(np.abs(pair.here_m[:, 0]).min(), np.abs(pair.there_m[:, 0]).min()) > 3.0
    assert report.starts.share(Outcome.ALIKE) > 0.5
    again = [in_the_world(world, report.known, report, c.start) for c in pair.confused]
    alike = [
        c.remains_in(start) and start.outcome is Outcome.ALIKE
        for c, start in zip(pair.confused, again, strict=True)
    ]
    assert np.mean(alike) >= 0.9


def test_the_suggested_box_resolves_it_in_the_world(world: World, report: Report) -> None:
    (found,) = report.resolutions
    assert found.box is not None
    assert found.resolved >= 0.7 * found.poses
    changed = replace(
        world, segments_m=np.concatenate([world.segments_m, edges(found.box.corners_m)])
    )
    known = map_of(changed, BOTH)
    confused = found.pair.confused
    again = [in_the_world(changed, known, report, c.start) for c in confused]
    resolved = sum(not c.remains_in(start) for c, start in zip(confused, again, strict=True))
    assert resolved / len(confused) >= found.resolved / found.poses - 0.2
    assert all(start.outcome is not Outcome.WRONG for start in again)


def test_the_same_map_gives_the_same_report(report: Report) -> None:
    board = Switchboard(report.known, report.eyes, PARAMS, report.params)
    for one in report.starts.tried[:4]:
        assert board.start(one.truth, even=one.even) == one


def test_page_and_json_tell_pairs_and_boxes(report: Report) -> None:
    about = About(
        map_id="1", file_name="twins.amrmap", file_sha256="2", map_format=2, software="0",
        made_at="now", robot="two scanners",
    )  # fmt: skip
    told = facts(report, about)
    assert told["overall"] == "act first"
    assert told["look_alikes"][0]["poses"] == len(report.pairs[0].confused)
    (found,) = report.resolutions
    assert told["suggestions"][0]["resolved"] == found.resolved
    text = page(report, about)
    assert f"<b>{found.resolved} of {found.poses}</b> poses at which A was taken for A*" in text
    assert text.count('<polygon class="box"') == 1


def start_at(x: float, y: float, *rivals: tuple[float, float]) -> ColdStart:
    return ColdStart(
        truth=Pose2(x, y, 0.0),
        outcome=Outcome.ALIKE,
        rivals=tuple(Pose2(*at, 1.0) for at in rivals),
        odds=0.5,
        even=True,
    )


def test_a_pair_is_one_whichever_of_its_areas_the_robot_stands_in() -> None:
    here = [start_at(0.5 * i, 0.0, (20.0, 0.5 * i)) for i in range(4)]
    there = [start_at(20.0, 0.25 + 0.5 * i, (0.25 + 0.5 * i, 0.0)) for i in range(4)]
    elsewhere = [start_at(0.5 * i, 40.0, (20.0, 40.0)) for i in range(3)]
    alone = [start_at(100.0, 0.0, (130.0, 0.0))]
    first, second = pairs([*here, *there, *elsewhere, *alone], 2.0)
    assert (first.letter, len(first.confused)) == ("A", 8)
    assert (second.letter, len(second.confused)) == ("B", 3)
    # All that lies in one area is in one column.
    assert np.ptp(first.here_m[:, 0]) < 3.0
    assert np.ptp(first.there_m[:, 0]) < 3.0
    assert sorted([first.here_m[0, 0] < 10.0, first.there_m[0, 0] < 10.0]) == [False, True]


def test_three_alike_places_are_three_pairs() -> None:
    places = ((0.0, 0.0), (10.0, 0.0), (20.0, 0.0))
    starts = [
        start_at(x + 0.2 * i, y, *((a + 0.2 * i, b) for a, b in places if (a, b) != (x, y)))
        for x, y in places
        for i in range(3)
    ]
    found = pairs(starts, 1.0)
    assert [len(pair.confused) for pair in found] == [6, 6, 6]
