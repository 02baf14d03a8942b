"""What speaks for a pose, and the verdict on it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import cloud_at, exact_target, room, world_of

from amr_slam.evidence import (
    Hypothesis,
    Rung,
    Verdict,
    apart,
    assess,
    decide,
    distinct,
    odds_of,
    plausibility,
)
from amr_slam.geometry import Array, Pose2
from amr_slam.params import Plausibility, SlamParams
from amr_slam.registration.alignment import Alignment, Target

PARAMS = SlamParams()
TRUTH = Pose2(3.0, 2.2, 0.3)
fixed = settings(derandomize=True, deadline=None, max_examples=100)


def aligned(pose: Pose2) -> Alignment:
    return Alignment(
        target_from_source=pose,
        information=np.diag([1e4, 1e4, 1e4]),
        converged=True,
        iterations=5,
        inliers=0.9,
        rmse_m=0.01,
    )


def place(number: int = 0, score: float = 0.9, agreeing: float = 0.95) -> Hypothesis:
    """A good one, 5 m from those of other numbers."""
    return Hypothesis(
        alignment=aligned(Pose2(5.0 * number, 0.0, 0.0)),
        score=score,
        inliers=0.9,
        known=0.95,
        conflict=0.01,
        passes=0.02,
        agreeing=agreeing,
        e_psr_m=0.02,
    )


scores = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=8)


@fixed
@given(scores=scores, agreeing=st.floats(0.0, 1.0))
def test_odds_are_those_of_alternatives(scores: list[float], agreeing: float) -> None:
    """Together no more than certain, the better fit never the less probable."""
    ranked = [place(i, s, agreeing) for i, s in enumerate(sorted(scores, reverse=True))]
    odds = odds_of(ranked, PARAMS.plausibility)
    assert len(odds) == len(ranked)
    assert all(0.0 <= p <= 1.0 for p in odds)
    assert sum(odds) <= 1.0 + 1e-12
    assert list(odds) == sorted(odds, reverse=True)
    # Rivals share, they do not add: all together are as probable as the best one without them.
    assert sum(odds) == pytest.approx(odds_of(ranked[:1], PARAMS.plausibility)[0])


@pytest.mark.parametrize("count", [2, 3, 6])
def test_equal_places_share_the_odds_equally(count: int) -> None:
    odds = odds_of([place(i) for i in range(count)], PARAMS.plausibility)
    np.testing.assert_allclose(odds, odds[0])
    assert 0.95 < sum(odds) <= 1.0


@fixed
@given(
    margin=st.floats(0.0, 1.0),
    agreeing=st.floats(0.0, 1.0),
    passes=st.floats(0.0, 1.0),
    more=st.floats(0.01, 0.5),
)
def test_better_evidence_is_never_less_probable(
    margin: float, agreeing: float, passes: float, more: float
) -> None:
    one = replace(place(), agreeing=agreeing, passes=passes)
    probable = plausibility(one, margin, PARAMS.plausibility)
    assert 0.0 < probable < 1.0
    for better, lead in (
        (one, margin + more),
        (replace(one, agreeing=agreeing + more), margin),
        (replace(one, passes=passes - more), margin),
    ):
        assert plausibility(better, lead, PARAMS.plausibility) >= probable


def test_extreme_evidence_is_no_overflow() -> None:
    wild = Plausibility(bias=1e6, margin=1e6)
    assert plausibility(place(), 1.0, wild) == pytest.approx(1.0)
    assert plausibility(place(), 1.0, replace(wild, bias=-1e9)) == pytest.approx(0.0)
    assert odds_of([place(0, 1.0), place(1, -1.0)], wild)[1] == 0.0


def test_two_equal_places_are_ambiguous() -> None:
    answer = decide([place(0), place(1)], 2, Rung.EXHAUSTIVE, PARAMS)
    assert answer.verdict is Verdict.AMBIGUOUS
    assert "2 places fit alike (odds 50%, 50%)" in str(answer.reason)
    assert answer.margin == 0.0
    assert len(answer.places) == 2


def test_poor_evidence_is_unknown_with_its_reason() -> None:
    poor = replace(place(score=0.3, agreeing=0.3), passes=0.4)
    answer = decide([poor], 1, Rung.EXHAUSTIVE, PARAMS)
    assert answer.verdict is Verdict.UNKNOWN
    assert "is right by" in str(answer.reason)
    # Two poor places are no better than one: that is not a choice between two good ones.
    answer = decide([poor, replace(poor, alignment=place(1).alignment)], 2, Rung.ABSOLUTE, PARAMS)
    assert answer.verdict is Verdict.UNKNOWN


@pytest.mark.parametrize("rung", list(Rung))
def test_good_evidence_without_a_rival_is_accepted(rung: Rung) -> None:
    answer = decide([place(0), place(1, score=0.1, agreeing=0.2)], 7, rung, PARAMS)
    assert answer.verdict is Verdict.ACCEPTED
    assert answer.reason is None
    assert answer.candidates == 7
    assert answer.best is not None
    assert answer.best.pose == place(0).pose


def test_what_is_probable_but_not_sure_goes_on_to_the_exhaustive_rung() -> None:
    """Between ``accept`` and ``sure`` the quick rung refuses, the exhaustive one accepts."""
    one = place(agreeing=0.8, score=0.6)
    bar = PARAMS.plausibility
    probable = plausibility(one, 0.3, bar)
    assert bar.accept < probable < bar.sure
    rival = replace(place(1), score=0.3)
    verdicts = {
        rung: decide([one, rival], 2, rung, PARAMS).verdict
        for rung in (Rung.ABSOLUTE, Rung.EXHAUSTIVE, Rung.RELATIVE)
    }
    assert verdicts[Rung.ABSOLUTE] is not Verdict.ACCEPTED
    assert verdicts[Rung.EXHAUSTIVE] is Verdict.ACCEPTED
    assert verdicts[Rung.RELATIVE] is Verdict.ACCEPTED  # near a prior there is little to choose


def test_around_the_prior_a_lead_is_demanded_by_itself() -> None:
    answer = decide([place(0), place(1, score=0.85)], 2, Rung.RESCUE, PARAMS)
    assert answer.verdict is Verdict.AMBIGUOUS
    assert "margin 0.05 < 0.20" in str(answer.reason)


def test_a_second_place_below_nothing_lends_no_lead() -> None:
    alone = decide([place(0)], 1, Rung.ABSOLUTE, PARAMS)
    beside = decide([place(0), place(1, score=-0.5)], 2, Rung.ABSOLUTE, PARAMS)
    assert beside.margin == alone.margin == place(0).score


def test_results_of_one_place_are_one_place() -> None:
    near = replace(place(0, 0.8), alignment=aligned(Pose2(0.2, 0.1, 0.05)))
    turned = replace(place(0, 0.7), alignment=aligned(Pose2(0.0, 0.0, 0.2)))
    kept = distinct([place(0), near, turned, place(1, 0.6)])
    assert [one.score for one in kept] == [0.9, 0.7, 0.6]
    answer = decide([near, place(0)], 2, Rung.EXHAUSTIVE, PARAMS)
    assert answer.second is None
    assert answer.best is not None
    assert answer.best.score == 0.9


@fixed
@given(
    x=st.floats(-1.0, 1.0), y=st.floats(-1.0, 1.0), a=st.floats(-3.2, 3.2), b=st.floats(-3.2, 3.2)
)
def test_apart_is_symmetric(x: float, y: float, a: float, b: float) -> None:
    one, other = Pose2(0.0, 0.0, a), Pose2(x, y, b)
    assert apart(one, other) == apart(other, one)
    assert not apart(one, one)
    full_turn = Pose2(0.0, 0.0, a + 2.0 * math.pi)
    assert not apart(one, full_turn)


def known_room(extra: Array | None = None) -> Target:
    """The bare room with its floor seen free, and what else stands in the map."""
    segments = room().segments_m
    if extra is not None:
        segments = np.concatenate([segments, extra])
    walls = exact_target(world_of(segments))
    x, y = np.meshgrid(np.arange(0.35, 7.7, 0.1), np.arange(0.35, 5.7, 0.1))
    return Target(
        points_m=walls.points_m,
        normals=walls.normals,
        free_m=np.column_stack([x.ravel(), y.ravel()]),
    )


def test_at_the_right_place_everything_agrees() -> None:
    cloud = cloud_at(room(), TRUTH, np.random.default_rng(0), sigma_m=0.01)
    found = assess(cloud, known_room(), aligned(TRUTH), PARAMS)
    assert found.score > 0.9
    assert found.agreeing > 0.97
    assert found.inliers > 0.99
    assert found.known == pytest.approx(1.0)
    assert found.conflict == 0.0
    assert found.passes < 0.01
    assert found.e_psr_m < 0.03
    wrong = assess(cloud, known_room(), aligned(TRUTH @ Pose2(0.8, 0.5, 0.4)), PARAMS)
    assert wrong.score < 0.5
    assert wrong.agreeing < 0.5


def test_a_wall_that_beams_pass_speaks_against_a_place() -> None:
    """The map knows a wall across the room; the scan looks through it."""
    cloud = cloud_at(room(), TRUTH, np.random.default_rng(0), sigma_m=0.01)
    barred = known_room(np.array([[5.0, 0.5, 5.0, 5.5]]))
    free, found = (
        assess(cloud, target, aligned(TRUTH), PARAMS) for target in (known_room(), barred)
    )
    assert 0.2 < found.passes < 0.6
    assert found.agreeing < free.agreeing - 0.2
    assert found.score == pytest.approx(free.score - 0.3 * (found.passes - free.passes), abs=0.02)
    assert plausibility(found, 0.3, PARAMS.plausibility) < plausibility(
        free, 0.3, PARAMS.plausibility
    )


def test_what_stands_in_free_space_is_in_conflict_but_passes_nothing() -> None:
    people = np.array([[4.5, 2.2], [3.0, 4.0], [1.5, 1.5]])
    rng = np.random.default_rng(0)
    cloud = cloud_at(room(), TRUTH, rng, sigma_m=0.01, people_m=people)
    found = assess(cloud, known_room(), aligned(TRUTH), PARAMS)
    assert 0.03 < found.conflict < 0.4
    assert found.passes < 0.01
    assert found.agreeing < 0.97


def test_new_territory_is_not_known_and_not_in_conflict() -> None:
    """A room of twice the length against the map of its half: what lies beyond tells nothing."""
    longer = room(16.0, 6.0)
    walls = exact_target(longer)
    half = walls.points_m[:, 0] < 8.0
    target = Target(points_m=walls.points_m[half], normals=walls.normals[half])
    cloud = cloud_at(longer, Pose2(7.0, 3.0, 0.0), np.random.default_rng(0), sigma_m=0.01)
    found = assess(cloud, target, aligned(Pose2(7.0, 3.0, 0.0)), PARAMS)
    assert 0.3 < found.known < 0.8
    assert found.inliers > 0.98
    assert found.conflict == 0.0
