from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from labs import (
    EXACT,
    cloud_at,
    covered_poses,
    heading_error_rad,
    lab,
    mapped_lab,
    plain_cloud,
    room,
    tour_poses,
    world_of,
)

from amr_slam.clouds import Cloud, CloudParams, cloud_from_points, cloud_from_scan
from amr_slam.engine import SlamEngine
from amr_slam.evidence import decide
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.map import MapParams, PointMap
from amr_slam.params import SlamParams, preset
from amr_slam.registration.field import FieldParams
from amr_slam.registration.icp import Prior
from amr_slam.samples import Scan
from amr_slam.slam import (
    Answer,
    Rung,
    Verdict,
    local_candidates,
    slam_absolute,
    slam_relative,
)
from amr_slam.slam_request import SlamRequest

PARAMS = SlamParams()


def prior_at(pose: Pose2, sigma_m: float = 0.15, sigma_deg: float = 5.0) -> Prior:
    sigmas = np.array([sigma_m, sigma_m, math.radians(sigma_deg)])
    return Prior(target_from_source=pose, information=np.diag(sigmas**-2))


def climbed(cloud: Cloud, grown: PointMap, prior: Prior) -> Answer:
    """The ladder up to the first accepted answer, or its end."""
    answer = None
    for answer in slam_relative(cloud, grown, prior, PARAMS):
        if answer.verdict is Verdict.ACCEPTED:
            break
    assert answer is not None
    return answer


def assert_right(answer: Answer, truth: Pose2, off_m: float = 0.05, off_deg: float = 0.5) -> None:
    assert answer.verdict is Verdict.ACCEPTED
    assert answer.reason is None
    assert answer.best is not None
    assert answer.best.pose.distance_to(truth) < off_m
    assert math.degrees(heading_error_rad(answer.best.pose, truth)) < off_deg


@pytest.mark.parametrize("seed", [0, 1])
def test_a_scan_is_found_anywhere_in_the_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = list(covered_poses(seed, 20))
    found = 0
    for pose in poses:
        answer = slam_absolute(
            cloud_at(lab(seed), pose, rng, sigma_m=0.01), mapped_lab(seed), PARAMS
        )
        if answer.verdict is Verdict.ACCEPTED:
            assert_right(answer, pose)
            found += 1
    assert found >= 0.95 * len(poses)


@pytest.mark.parametrize(("mapped", "seen"), [(0, 1), (1, 0)])
def test_a_scan_of_another_laboratory_is_never_accepted(mapped: int, seen: int) -> None:
    rng = np.random.default_rng(seen)
    for pose in covered_poses(seen, 4, draw=1):
        answer = slam_absolute(
            cloud_at(lab(seen), pose, rng, sigma_m=0.01), mapped_lab(mapped), PARAMS
        )
        assert answer.verdict is not Verdict.ACCEPTED
        assert answer.reason


@pytest.mark.parametrize("seed", [0, 1])
def test_the_first_rung_corrects_the_wheels(seed: int) -> None:
    rng = np.random.default_rng(seed + 10)
    for pose in tour_poses(seed)[::8]:
        off = rng.normal(0.0, [0.15, 0.15, math.radians(5.0)])
        believed = pose @ Pose2.from_array(off)
        cloud = cloud_at(lab(seed), pose, rng, sigma_m=0.01)
        answer = next(slam_relative(cloud, mapped_lab(seed), prior_at(believed), PARAMS))
        assert answer.rung is Rung.RELATIVE
        assert_right(answer, pose)


@pytest.mark.parametrize("place", [15, 40])
def test_a_prior_five_metres_wrong_falls_through_to_the_whole_map(place: int) -> None:
    """Every rung below refuses, and the last one finds the place."""
    poses = tour_poses(0)
    truth = poses[place]
    far = [pose for pose in poses if 4.5 < pose.distance_to(truth) < 6.0]
    believed = far[len(far) // 2]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(place), sigma_m=0.01)
    answers = list(slam_relative(cloud, mapped_lab(0), prior_at(believed), PARAMS))
    rungs = [Rung.RELATIVE, Rung.CPD, Rung.ABSOLUTE, Rung.EXHAUSTIVE]
    assert [answer.rung for answer in answers] == rungs
    assert answers[0].verdict is Verdict.UNKNOWN
    assert_right(answers[-1], truth)


def test_a_growing_map_is_searched_around_the_expected_place_only() -> None:
    truth = tour_poses(0)[30]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    near = prior_at(truth @ Pose2(1.0, -0.8, 2.5))
    answers = list(slam_relative(cloud, mapped_lab(0), near, PARAMS, everywhere=False))
    assert [answer.rung for answer in answers] == [Rung.RELATIVE, Rung.CPD, Rung.RESCUE]
    assert_right(answers[-1], truth)
    far = prior_at(Pose2(truth.x_m + 6.0, truth.y_m, truth.theta_rad))
    *_, last = slam_relative(cloud, mapped_lab(0), far, PARAMS, everywhere=False)
    assert last.verdict is not Verdict.ACCEPTED


def test_local_candidates_fill_the_window_of_the_prior() -> None:
    truth = tour_poses(0)[30]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    target = mapped_lab(0).target()
    reach = []
    for sigma in (0.01, 0.3, 5.0):
        prior = prior_at(truth, sigma, 3.0)
        candidates = local_candidates(cloud, target, prior, PARAMS)
        np.testing.assert_array_equal(candidates[0], truth.as_array())
        reach.append(np.hypot(*(candidates[:, :2] - truth.translation).T).max())
        assert len(candidates) <= 1 + PARAMS.local_candidates
        off = wrap_angle(candidates[:, 2] - truth.theta_rad)
        assert np.abs(off).max() <= PARAMS.window_max[2] + 1e-9
    assert max(reach) <= math.hypot(*PARAMS.window_max[:2]) + 1e-9


def test_a_room_that_looks_the_same_both_ways_is_ambiguous() -> None:
    """A bare rectangle fits a second time, turned by half: it must not be guessed."""
    grown, rng = PointMap(MapParams()), np.random.default_rng(0)
    for pose in (Pose2(3, 2, 0.3), Pose2(5, 4, -1.0), Pose2(4, 3, 2.0)):
        grown.insert(cloud_at(room(), pose, rng, sigma_m=0.01), pose)
    truth = Pose2(2.5, 2.0, 0.7)
    answer = slam_absolute(cloud_at(room(), truth, rng, sigma_m=0.01), grown, PARAMS)
    assert answer.verdict is Verdict.AMBIGUOUS
    assert answer.reason
    assert answer.best is not None
    assert answer.second is not None
    both = {round(pose.distance_to(truth), 1) for pose in (answer.best.pose, answer.second.pose)}
    assert both == {0.0, round(2.0 * math.hypot(1.5, 1.0), 1)}
    # Who knows roughly where he is needs not guess.
    assert_right(climbed(cloud_at(room(), truth, rng, sigma_m=0.01), grown, prior_at(truth)), truth)


def polar(ranges: Array) -> Cloud:
    scan = Scan(
        scanner="front",
        stamp_ns=0,
        ranges_m=ranges,
        angle_min_rad=EXACT.angle_min_rad,
        angle_step_rad=EXACT.angle_step_rad,
    )
    return cloud_from_scan(scan, Pose2.identity(), CloudParams())


def cartesian(points_m: Array) -> Cloud:
    return cloud_from_points(points_m, Pose2.identity(), CloudParams(), step_rad=math.radians(0.5))


def half_broken(points_m: Array) -> Array:
    """The same with NaN and inf in every other row."""
    broken = points_m.copy()
    broken[::4, 0], broken[2::4, 1] = math.nan, math.inf
    return broken


WALL = world_of(np.array([[2.0, -4.0, 2.0, 4.0]]))
DEGENERATE: dict[str, Callable[[], Cloud]] = {
    "empty": lambda: plain_cloud(np.empty((0, 2))),
    "no return": lambda: polar(np.full(541, math.inf)),
    "nan": lambda: polar(np.full(541, math.nan)),
    "minus infinity": lambda: polar(np.full(541, -math.inf)),
    "points that are none": lambda: cartesian(np.full((300, 2), math.nan)),
    "infinitely far points": lambda: cartesian(np.full((300, 2), math.inf)),
    "three points": lambda: plain_cloud(np.array([[1.0, 0.0], [1.0, 0.1], [1.0, 0.2]])),
    "one point": lambda: plain_cloud(np.array([[1.0, 0.0]])),
    "all in one place": lambda: plain_cloud(np.full((100, 2), 1.5), weight=0.05),
    "dust on the window": lambda: polar(np.full(541, 0.06)),
    "one wall": lambda: cloud_at(WALL, Pose2.identity(), np.random.default_rng(0)),
    "a disc": lambda: polar(np.full(541, 1.0)),
    "noise": lambda: polar(np.random.default_rng(0).uniform(0.1, 20.0, 541)),
}


BLIND = (
    "empty",
    "no return",
    "nan",
    "minus infinity",
    "points that are none",
    "infinitely far points",
    "three points",
    "one point",
    "dust on the window",
)
"""Those that show less than half a metre of surface."""


@pytest.mark.parametrize("name", BLIND)
def test_a_blind_scan_has_no_pose_and_a_reason(name: str) -> None:
    cloud, grown, pose = DEGENERATE[name](), mapped_lab(0), tour_poses(0)[20]
    answers = [slam_absolute(cloud, grown, PARAMS)]
    for everywhere in (True, False):
        answers += slam_relative(cloud, grown, prior_at(pose), PARAMS, everywhere=everywhere)
    assert len(answers) >= 6
    for answer in answers:
        assert answer.verdict is Verdict.UNKNOWN, answer.rung
        assert answer.places == ()
        assert answer.odds == ()
        assert answer.reason in {
            "the scan is empty",
            "the scan shows less than half a metre of surface",
        }


@pytest.mark.parametrize("name", BLIND)
def test_a_blind_scan_is_no_fix_and_no_part_of_a_map(name: str) -> None:
    cloud, pose = DEGENERATE[name](), tour_poses(0)[20]
    finding = SlamEngine(PARAMS, mapped_lab(0), "localization")
    grown = line_map()
    mapping = SlamEngine(PARAMS, grown, "mapping")
    points = len(grown)
    expected = SlamRequest(cloud=cloud, map_from_base=pose, covariance=0.01 * np.eye(3))
    for result in (
        finding.update(expected),
        finding.update(replace(expected, map_from_base=None, covariance=None)),
        mapping.update(expected),
    ):
        assert result.fix is None
        assert not result.inserted
        assert result.answer.reason
    assert len(grown) == points


def test_what_is_left_of_a_broken_scan_still_finds_its_place() -> None:
    truth = tour_poses(0)[30]
    whole = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    cloud = cartesian(half_broken(whole.points_m))
    assert np.all(np.isfinite(cloud.points_m))
    assert np.all(np.isfinite(cloud.normals))
    assert 0.3 * len(whole) < len(cloud) < 0.6 * len(whole)
    assert_right(climbed(cloud, mapped_lab(0), prior_at(truth @ Pose2(0.1, 0.1, 0.1))), truth)


@pytest.mark.parametrize("name", DEGENERATE)
def test_a_scan_that_tells_nothing_is_never_accepted_without_a_prior(name: str) -> None:
    answer = slam_absolute(DEGENERATE[name](), mapped_lab(0), PARAMS)
    assert answer.verdict is not Verdict.ACCEPTED
    assert answer.reason


@pytest.mark.parametrize("name", DEGENERATE)
def test_a_scan_that_tells_nothing_climbs_the_ladder_without_an_exception(name: str) -> None:
    cloud, pose = DEGENERATE[name](), tour_poses(0)[20]
    for prior in (prior_at(pose), prior_at(pose, 1e-6, 1e-6), prior_at(pose, 1e4, 180.0)):
        for answer in slam_relative(cloud, mapped_lab(0), prior, PARAMS):
            assert answer.verdict is not Verdict.ACCEPTED, answer.rung
            assert answer.reason


def line_map() -> PointMap:
    """All that was ever seen is one wall."""
    grown = PointMap(MapParams())
    for x in (0.0, 0.5):
        pose = Pose2(x, x, 0.0)
        grown.insert(cloud_at(WALL, pose, np.random.default_rng(0)), pose)
    return grown


def speck_map() -> PointMap:
    """All that was ever seen is a post."""
    grown = PointMap(MapParams())
    points = np.array([[1.0, 0.0], [1.0, 0.05], [1.0, 0.1]])
    grown.insert(plain_cloud(points), Pose2.identity())
    return grown


@pytest.mark.parametrize("make", [lambda: PointMap(MapParams()), line_map, speck_map])
def test_a_map_that_tells_nothing_accepts_nothing(make: Callable[[], PointMap]) -> None:
    grown = make()
    pose = tour_poses(0)[20]
    full = cloud_at(lab(0), pose, np.random.default_rng(0), sigma_m=0.01)
    clouds = [full, *(DEGENERATE[name]() for name in ("empty", "three points", "nan"))]
    for cloud in clouds:
        answers = [slam_absolute(cloud, grown, PARAMS)]
        answers += slam_relative(cloud, grown, prior_at(Pose2(0.0, 3.0, 1.5)), PARAMS)
        for answer in answers:
            assert answer.verdict is not Verdict.ACCEPTED
            assert answer.reason


def test_one_wall_in_a_map_of_one_wall_is_known_across_it_only() -> None:
    cloud = DEGENERATE["one wall"]()
    for answer in slam_relative(cloud, line_map(), prior_at(Pose2(0.0, 1.0, 0.0)), PARAMS):
        if answer.verdict is Verdict.ACCEPTED:
            assert answer.best is not None
            information = answer.best.alignment.information
            assert np.linalg.eigvalsh(information)[0] < 1e-3 * information[0, 0]


def test_people_in_the_scan_do_not_hide_the_place() -> None:
    truth = tour_poses(0)[30]
    people = np.array([tour_poses(0)[i].translation for i in (27, 32, 33)])
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01, people_m=people)
    assert_right(climbed(cloud, mapped_lab(0), prior_at(truth @ Pose2(0.1, 0.1, 0.1))), truth)


def test_the_verdict_says_what_is_missing() -> None:
    """A right pose, one of its figures at a time put to the wrong side of the bar."""
    truth, bar = tour_poses(0)[30], PARAMS.absolute
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    best = slam_absolute(cloud, mapped_lab(0), PARAMS).best
    assert best is not None
    assert decide([best], 1, Rung.ABSOLUTE, PARAMS).verdict is Verdict.ACCEPTED
    for wrong, word in (
        (replace(best, inliers=bar.inliers - 0.01), "walls"),
        (replace(best, known=bar.known - 0.01), "knows anything"),
        (replace(best, conflict=bar.conflict + 0.01), "free space"),
        (replace(best, e_psr_m=bar.e_max_m), "registration error"),
    ):
        answer = decide([wrong], 1, Rung.ABSOLUTE, PARAMS)
        assert answer.verdict is Verdict.UNKNOWN
        assert word in str(answer.reason)
    elsewhere = replace(best.alignment, target_from_source=truth @ Pose2(3.0, 0.0, 1.0))
    close = replace(best, alignment=elsewhere, score=best.score - 0.01)
    answer = decide([best, close], 2, Rung.EXHAUSTIVE, PARAMS)
    assert answer.verdict is Verdict.AMBIGUOUS
    assert "2 places fit alike" in str(answer.reason)
    assert 0.5 < answer.odds[0] < 0.6
    assert 0.9 < sum(answer.odds) <= 1.0
    assert answer.second is close


def test_poses_that_are_told_are_tried_beside_what_is_found() -> None:
    """Where earlier scans said that the robot may be: the search need not find it again."""
    truth = tour_poses(0)[30]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    blind = replace(PARAMS, absolute_candidates=1, exhaustive=replace(FieldParams(), candidates=0))
    blocked = PointMap(MapParams())
    # A map of walls without any place to stand: nothing but what is told can be tried.
    blocked.insert(replace(cloud, origins_m=cloud.points_m), truth)
    assert not len(blocked.places(PARAMS.grid_m, PARAMS.robot_radius_m))
    assert slam_absolute(cloud, blocked, blind).reason == "no candidate place"
    told = np.array([(truth @ Pose2(0.1, -0.1, 0.05)).as_array()])
    answer = slam_absolute(cloud, blocked, blind, told)
    assert answer.best is not None
    assert answer.best.pose.distance_to(truth) < 0.02


@pytest.mark.parametrize("place", [12, 40])
def test_the_exhaustive_rung_is_climbed_only_in_doubt(place: int) -> None:
    truth = tour_poses(0)[place]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(place), sigma_m=0.01)
    assert slam_absolute(cloud, mapped_lab(0), PARAMS).rung is Rung.ABSOLUTE
    doubting = replace(PARAMS, plausibility=replace(PARAMS.plausibility, sure=1.0))
    answer = slam_absolute(cloud, mapped_lab(0), doubting)
    assert answer.rung is Rung.EXHAUSTIVE
    assert_right(answer, truth)
    both = PARAMS.absolute_candidates + PARAMS.exhaustive.candidates
    assert answer.candidates == both
    without = replace(doubting, exhaustive=replace(FieldParams(), candidates=0))
    assert slam_absolute(cloud, mapped_lab(0), without).rung is Rung.ABSOLUTE


def test_the_papers_own_settings_work_near_the_prior() -> None:
    paper = preset("paper")
    truth = tour_poses(0)[30]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    believed = prior_at(truth @ Pose2(0.1, -0.1, 0.05))
    answer = next(slam_relative(cloud, mapped_lab(0), believed, paper))
    assert_right(answer, truth, off_m=0.1, off_deg=2.0)
