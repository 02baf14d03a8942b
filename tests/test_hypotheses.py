from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from localizer_rig import SURE, answer_of, hypothesis

from amr_slam.evidence import Answer, Verdict, unknown
from amr_slam.geometry import Pose2
from amr_slam.hypotheses import Hypotheses, TrackingParams
from amr_slam.samples import Motion

PARAMS = TrackingParams()
HERE = Pose2(3.0, 2.0, 0.7)
TWIN = Pose2(-12.0, 4.0, 2.9)
AHEAD = Pose2(1.0, 0.0, 0.2)
NOISE = np.diag([0.02**2, 0.02**2, 0.01**2])


class Walk:
    """A tracker, and wheels that go one step between two scans."""

    def __init__(self, params: TrackingParams = PARAMS) -> None:
        self.tracker = Hypotheses(params)
        self.moved = Pose2.identity()
        self.now_ns = 0

    def step(self, by: Pose2, *, gap: bool = False, known: bool = True) -> Walk:
        start_ns, self.now_ns = self.now_ns, self.now_ns + 2_000_000_000
        motion = Motion(start_ns=start_ns, end_ns=self.now_ns, delta=by, covariance=NOISE, gap=gap)
        self.moved = self.moved @ by
        self.tracker.carry(self.now_ns, lambda _start, _end: motion if known else None)
        return self

    def see(self, *places: tuple[Pose2, float], verdict: Verdict | None = None) -> Walk:
        """Places by where the walk began; each is found where the wheels have led since."""
        return self.hear(answer_of(*((at @ self.moved, o) for at, o in places), verdict=verdict))

    def hear(self, answer: Answer) -> Walk:
        self.tracker.weigh(self.now_ns, answer, _no_motion)
        return self

    @property
    def odds(self) -> list[float]:
        return [one.odds for one in self.tracker.candidates()]

    @property
    def best(self) -> Pose2:
        return self.tracker.candidates()[0].map_from_base


def _no_motion(start_ns: int, end_ns: int) -> Motion | None:
    raise AssertionError("carried already")


def test_one_scan_gives_each_place_its_odds_and_like_places_the_same() -> None:
    assert Walk().see((HERE, 0.97)).odds == pytest.approx([0.97])
    told_apart = Walk().see((HERE, 0.8), (TWIN, 0.1)).odds
    assert told_apart[0] / told_apart[1] == pytest.approx(8.0 / PARAMS.alike)
    alike = Walk().see((HERE, 0.6), (TWIN, 0.3))
    assert alike.odds[0] == pytest.approx(alike.odds[1])
    assert alike.tracker.unique() is None
    assert Walk().see((HERE, 0.9999)).tracker.unique() is None


def test_places_go_where_the_wheels_go() -> None:
    walk = Walk().see((HERE, 0.6), (TWIN, 0.3)).step(AHEAD)
    here, twin = walk.tracker.candidates()
    assert here.map_from_base.distance_to(HERE @ AHEAD) < 1e-9
    assert twin.map_from_base.distance_to(TWIN @ AHEAD) < 1e-9
    poses = walk.tracker.poses()
    assert poses is not None
    assert poses.shape == (2, 3)


def test_two_views_that_agree_locate_with_the_pose_of_both() -> None:
    walk = Walk().see((HERE, 0.999)).step(AHEAD).see((HERE, 0.999))
    found = walk.tracker.unique()
    assert found is not None
    assert found[0].distance_to(HERE @ AHEAD) < 1e-6
    assert np.linalg.eigvalsh(found[1])[0] > 0.0
    assert found[1][0, 0] < 2.0 * SURE[0, 0]


@pytest.mark.parametrize("step", [Pose2(0.2, 0.1, 0.0), Pose2(0.0, 0.0, 0.25), Pose2(0, 0, 0)])
def test_the_scans_of_a_standing_robot_are_one_witness(step: Pose2) -> None:
    walk = Walk().see((HERE, 0.97), (TWIN, 0.02))
    before = walk.odds
    for number in range(20):
        walk.step(step if number == 0 else Pose2.identity()).see((HERE, 0.97), (TWIN, 0.02))
        assert walk.tracker.unique() is None
    assert walk.odds == pytest.approx(before, abs=1e-9)


def test_going_back_and_forth_adds_no_witness_either() -> None:
    walk = Walk().see((HERE, 0.8), (TWIN, 0.15)).step(AHEAD).see((HERE, 0.8), (TWIN, 0.15))
    after_two = walk.odds
    for step in [AHEAD.inverse(), AHEAD] * 10:
        walk.step(step).see((HERE, 0.8), (TWIN, 0.15))
        assert walk.tracker.unique() is None
    assert walk.odds == pytest.approx(after_two, abs=1e-6)


def test_a_standing_robot_is_located_by_scans_that_each_leave_no_doubt() -> None:
    walk = Walk()
    for number in range(1, PARAMS.standing_scans + 1):
        walk.see((HERE, 0.9995), verdict=Verdict.ACCEPTED)
        assert (walk.tracker.unique() is not None) is (number == PARAMS.standing_scans)
        walk.step(Pose2.identity())
    # One doubtful scan between them, and the counting begins anew.
    walk = Walk()
    for verdict in (Verdict.ACCEPTED, Verdict.ACCEPTED, Verdict.AMBIGUOUS, Verdict.ACCEPTED):
        walk.see((HERE, 0.9995), verdict=verdict).step(Pose2.identity())
    assert walk.tracker.unique() is None


def test_to_be_found_again_where_the_wheels_say_counts_beside_the_odds() -> None:
    """Doubtful each time, but at one place: it gains on what comes and goes."""
    walk = Walk().see((HERE, 0.4))
    odds = [walk.odds[0]]
    for number in range(4):
        passing = Pose2(30.0 + 9.0 * number, 0.0, 0.0)
        walk.step(AHEAD).see((HERE, 0.4), (passing, 0.3))
        odds.append(walk.odds[0])
        assert walk.best.distance_to(HERE @ walk.moved) < 1e-6
    assert odds == sorted(odds)
    assert odds[-1] > 0.75


def test_a_look_alike_keeps_the_robot_from_being_located() -> None:
    walk = Walk()
    for _ in range(50):
        walk.see((HERE, 0.6), (TWIN, 0.39)).step(AHEAD)
        assert walk.tracker.unique() is None
        assert walk.odds[1] > 0.4
    assert sum(walk.odds) < 1.0  # "none of them" keeps a share


def test_what_the_newer_scans_do_not_find_fades() -> None:
    walk = Walk().see((TWIN, 0.7), (HERE, 0.25))
    for _ in range(4):
        walk.step(AHEAD).see((HERE, 0.95))
    assert walk.best.distance_to(HERE @ walk.moved) < 1e-6
    assert walk.tracker.unique() is not None
    assert walk.odds[1] < 1e-3


def test_none_of_them_can_win() -> None:
    """Another building: each scan finds some place, and none twice."""
    walk, rng = Walk(), np.random.default_rng(1)
    for _ in range(20):
        somewhere = Pose2.from_array(rng.uniform([-50, -50, -3], [50, 50, 3]))
        walk.step(AHEAD).see((somewhere, 0.5), (somewhere @ Pose2(3, 3, 1), 0.2))
        assert walk.tracker.unique() is None
        assert len(walk.tracker) <= PARAMS.most
    assert sum(walk.odds) < 0.5


def test_the_newest_scan_must_have_found_the_place() -> None:
    walk = Walk().see((HERE, 0.97)).step(AHEAD).see((HERE, 0.97)).step(AHEAD)
    assert walk.tracker.unique() is None
    strong = walk.see((HERE, 0.9999)).step(AHEAD)
    assert strong.tracker.unique() is not None
    strong.see((TWIN, 0.2))
    assert strong.tracker.unique() is None


def test_an_answer_without_places_says_nothing() -> None:
    walk = Walk().see((HERE, 0.6), (TWIN, 0.3)).step(AHEAD)
    before = walk.odds
    walk.hear(unknown("the scan is empty"))
    assert walk.odds == before


@pytest.mark.parametrize(("gap", "known"), [(True, True), (False, False)])
def test_wheels_that_do_not_know_end_the_tracking(gap: bool, known: bool) -> None:
    walk = Walk().see((HERE, 0.999)).step(AHEAD, gap=gap, known=known)
    assert len(walk.tracker) == 0
    assert walk.see((HERE, 0.999)).tracker.unique() is None


def test_the_expected_pose_is_not_given_up_for_one_scan() -> None:
    walk = Walk()
    walk.tracker.expect(0, HERE, SURE)
    walk.see((TWIN, 0.999))
    assert walk.tracker.unique() is None
    doubted = walk.tracker.home_odds
    assert doubted is not None
    assert 0.02 < doubted < 0.2
    walk.step(AHEAD).see((HERE, 0.99), (TWIN, 0.001))
    assert walk.tracker.home_odds is not None
    assert walk.tracker.home_odds > 0.5
    walk.step(AHEAD).see((HERE, 0.9999))
    assert walk.tracker.unique() is None  # nothing to jump to


def test_along_a_corridor_the_way_of_the_wheels_remains() -> None:
    """A scan that knows nothing about x does not move the place along x."""
    corridor = np.diag([1e3, 1e-4, 1e-6])
    walk = Walk().see((Pose2.identity(), 0.9)).step(Pose2(2.0, 0.0, 0.0))
    slid = hypothesis(Pose2(2.5, 0.05, 0.0), corridor)
    walk.hear(replace(answer_of((slid.pose, 0.9)), places=(slid,)))
    assert walk.best.x_m == pytest.approx(2.0, abs=0.01)
    assert walk.best.y_m == pytest.approx(0.04, abs=0.02)


def test_the_same_answers_give_the_same_odds() -> None:
    def run() -> list[float]:
        walk, rng = Walk(), np.random.default_rng(7)
        for _ in range(15):
            odds = rng.dirichlet([4.0, 2.0, 1.0])
            walk.step(AHEAD).see((HERE, odds[0]), (TWIN, odds[1]))
        return walk.odds

    assert run() == run()
    assert all(math.isfinite(odds) for odds in run())
