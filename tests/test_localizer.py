from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from localizer_rig import DRIVE, PARAMS, SURE, Rig

from amr_slam.changes import Change
from amr_slam.clouds import CloudParams
from amr_slam.evidence import Verdict
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.samples import Outcome, PoseEstimate, Scan, State
from amr_slam.trust import too_wide

START = Pose2(2.0, 1.0, 0.5)


def located(pose: Pose2 = START) -> Rig:
    """Localized, and driving."""
    rig = Rig(start=pose)
    rig.drive(0.5)
    assert rig.answer(rig.truth) is Outcome.ACCEPTED
    assert rig.state() is State.LOCALIZED
    return rig


def assert_finite(estimate: PoseEstimate) -> None:
    assert estimate.map_from_base.is_finite()
    assert np.all(np.isfinite(estimate.covariance))
    assert np.linalg.eigvalsh(estimate.covariance)[0] > 0.0
    assert np.isfinite(estimate.error95_m)


def test_before_the_first_wheel_sample_there_is_no_pose() -> None:
    localizer = Localizer(
        PARAMS,
        FilterParams(),
        CloudParams(),
        DRIVE,
        {"front": Mounting(base_from_lidar=Pose2.identity())},
        "mapping",
    )
    assert localizer.estimate(0) is None
    scan = Scan(
        scanner="front",
        stamp_ns=5,
        ranges_m=np.ones(9),
        angle_min_rad=0.0,
        angle_step_rad=0.1,
    )
    assert localizer.handle(scan) is Outcome.FUTURE
    assert localizer.take_request() is None
    assert localizer.outcomes["scan.future"] == 1


def test_from_starting_over_mapping_to_odometry_only_and_lost() -> None:
    rig = Rig("mapping")
    rig.drive(0.5)
    assert rig.state() is State.STARTING
    assert rig.answer(None, inserted=True) is Outcome.ACCEPTED  # founds the map
    assert rig.state() is State.MAPPING
    rig.answer(rig.truth)
    states, claims = [], []
    for _ in range(round(PARAMS.lost_s) + 2):
        rig.drive(1.0)
        states.append(rig.state())
        claims.append(rig.estimate.error95_m)
        assert rig.estimate.since_fix_s == pytest.approx(len(states), abs=0.01)
        assert rig.estimate.since_fix_m == pytest.approx(0.3 * len(states), abs=0.01)
    order = [State.MAPPING, State.ODOMETRY_ONLY, State.LOST]
    assert sorted(set(states), key=states.index) == order
    assert states[round(PARAMS.fresh_s) - 2] is State.MAPPING
    assert states[round(PARAMS.fresh_s) + 1] is State.ODOMETRY_ONLY
    assert np.all(np.diff(claims) > 0.0)  # who travels without fixes says so
    rig.answer(rig.truth)
    assert rig.state() is State.MAPPING
    assert rig.estimate.error95_m < claims[-1]
    assert rig.estimate.epoch == 0


def test_without_a_start_it_is_lost_until_two_scans_from_two_poses_say_the_same() -> None:
    rig = Rig()
    assert rig.state() is State.STARTING
    there = Pose2(5.0, -3.0, 1.0)
    rig.answer(None)
    assert (rig.state(), rig.estimate.fault) == (State.LOST, "no such place")
    rig.drive(1.0)
    rig.scan()
    rig.drive(0.2)
    assert rig.requests[-1].map_from_base is None  # anywhere
    assert rig.requests[-1].also is None
    assert rig.found((there, 0.9995)) is Outcome.GATED
    assert rig.state() is State.AMBIGUOUS
    driven = rig.truth
    rig.drive(2.0)
    agreeing = there @ (driven.inverse() @ rig.truth)
    (candidate,) = rig.estimate.candidates
    assert candidate.map_from_base.distance_to(agreeing) < 0.02
    assert candidate.odds == pytest.approx(0.9995, abs=1e-4)
    rig.scan()
    rig.drive(0.2)
    here = there @ (driven.inverse() @ rig.truth)
    also = rig.requests[-1].also
    assert also is not None
    np.testing.assert_allclose(also, [agreeing.as_array()], atol=0.02)  # tried again
    assert rig.found((here, 0.9995)) is Outcome.RESET
    assert (rig.state(), rig.estimate.candidates) == (State.LOCALIZED, ())
    assert rig.estimate.epoch == 1
    assert rig.estimate.map_from_base.distance_to(here) < 0.02


def test_a_pose_without_a_heading_is_no_pose_to_drive_by() -> None:
    for heading_rad, verdict in ((0.3, False), (0.4, True)):
        assert too_wide(np.diag([1e-4, 1e-4, heading_rad**2]), LocalizerParams()) is verdict


def test_solutions_that_contradict_each_other_never_locate() -> None:
    rig, rng = Rig(), np.random.default_rng(0)
    for _ in range(10):
        rig.drive(1.0)
        pose = Pose2.from_array(rng.uniform([-9, -9, -3], [9, 9, 3]))
        assert rig.found((pose, 0.9995)) is Outcome.GATED
        assert rig.state() in {State.AMBIGUOUS, State.LOST}
    assert rig.estimate.epoch == 0


def test_two_places_that_look_alike_stay_two_until_a_scan_tells_them_apart() -> None:
    rig, twin = Rig(), Pose2(20.0, 5.0, 3.0)
    for _ in range(6):
        rig.drive(2.0)
        assert rig.found((rig.truth, 0.55), (twin @ rig.truth, 0.44)) is Outcome.UNKNOWN
        assert rig.state() is State.AMBIGUOUS
        shown = [one.map_from_base.distance_to(rig.truth) for one in rig.estimate.candidates]
        assert min(shown) < 0.05
        assert len(shown) == 2
        assert sum(one.odds for one in rig.estimate.candidates) > 0.98
    looks = 0
    while rig.state() is not State.LOCALIZED and looks < 9:
        rig.drive(2.0)
        rig.found((rig.truth, 0.99), (twin @ rig.truth, 0.005))
        looks += 1
    assert 1 < looks <= 5
    assert rig.off_m < 0.02


def test_a_lost_robot_that_knows_only_roughly_where_it_is_needs_two_views_as_well() -> None:
    rig = located()
    rig.pause(4.0)
    rig.scan()  # the wheels are silent: it may have driven meanwhile
    rig.drive(0.2)
    assert rig.state() is State.LOST
    look_alike = rig.truth @ Pose2(2.0, 1.0, 0.0)
    assert rig.found((look_alike, 0.9995)) is Outcome.GATED
    assert rig.state() is State.LOST
    looks = 0
    while rig.state() is not State.LOCALIZED and looks < 9:
        rig.drive(2.0)
        rig.found((rig.truth, 0.9995))
        looks += 1
    assert 2 <= looks <= 4  # they outweigh the look-alike
    assert rig.off_m < 0.02
    assert rig.estimate.epoch == 1


def test_a_kidnapped_robot_is_doubted_then_found_where_it_is() -> None:
    rig = located()
    jump, states = Pose2(4.0, 3.0, 1.0), []
    while rig.estimate.epoch == 0:
        rig.drive(2.0)
        moved = jump @ rig.truth
        before = rig.estimate
        rig.found((moved, 0.9995))
        states.append(rig.state())
        assert len(states) < 4
        if rig.estimate.epoch == 0:
            assert rig.estimate.map_from_base == before.map_from_base
    assert states[-1] is State.LOCALIZED
    assert len(states) > 1  # one scan is never enough
    assert rig.estimate.map_from_base.distance_to(moved) < 0.02
    assert rig.estimate.odom_from_base.distance_to(before.odom_from_base) < 0.01


def test_a_located_robot_that_is_told_otherwise_again_and_again_is_not_localized() -> None:
    rig = located()
    twin = Pose2(4.0, 3.0, 1.0)
    for _ in range(3):
        rig.drive(0.4)  # too little for a second view
        rig.found((twin @ rig.truth, 0.999))
    assert rig.state() in {State.AMBIGUOUS, State.LOST}
    assert rig.estimate.epoch == 0


OFFICE_MOVED = Change(explained=0.6, contradicting=0.38, sector_rad=(-0.35, 0.79))


def test_a_changed_place_is_told_and_the_pose_stays() -> None:
    rig = located()
    for _ in range(8):
        rig.drive(2.0)
        assert rig.near(rig.truth, OFFICE_MOVED) is Outcome.ACCEPTED
        assert rig.state() is State.LOCALIZED
        assert rig.estimate.explained == 0.6
        assert rig.estimate.fault == (
            "38% of the scan contradicts the map, ahead (bearing -20..45 deg): "
            "the place has changed?"
        )
    rig.drive(2.0)
    rig.near(rig.truth, replace(OFFICE_MOVED, contradicting=0.1))
    assert rig.estimate.fault is None


@pytest.mark.parametrize(("explained", "lost"), [(0.6, False), (0.3, True)])
def test_a_scan_that_fits_poorly_where_it_is_expected_is_no_fix_but_no_loss(
    explained: float, lost: bool
) -> None:
    rig = located()
    change = replace(OFFICE_MOVED, explained=explained)
    for _ in range(PARAMS.lost_refusals + 1):
        rig.drive(0.4)
        assert rig.near(rig.truth, change, verdict=Verdict.UNKNOWN) is Outcome.UNKNOWN
    assert rig.state() is (State.LOST if lost else State.LOCALIZED)
    assert ("changed" in str(rig.estimate.fault)) is not lost
    rig.drive(PARAMS.fresh_s)
    assert rig.state() is (State.LOST if lost else State.ODOMETRY_ONLY)


@pytest.mark.parametrize(
    ("relocalized", "needed"),
    [(True, PARAMS.agreeing_relocalizations), (False, PARAMS.agreeing_refusals)],
)
def test_the_pose_jumps_once_enough_solutions_near_it_agree(relocalized: bool, needed: int) -> None:
    rig = located()
    jump = Pose2(0.8, 0.5, 0.1)
    for number in range(1, needed + 1):
        rig.drive(1.0)
        before = rig.estimate
        moved = jump @ rig.truth
        outcome = rig.answer(moved, relocalized=relocalized)
        if number < needed:
            assert outcome is Outcome.GATED
            assert rig.off_m < 0.02
            assert rig.estimate.epoch == before.epoch
    assert outcome is Outcome.RESET
    assert rig.estimate.epoch == before.epoch + 1
    assert rig.estimate.map_from_base.distance_to(moved) < 0.01
    assert rig.state() is State.LOCALIZED
    # What the wheels say never jumps.
    assert rig.estimate.odom_from_base.distance_to(before.odom_from_base) < 0.01


def test_a_map_that_a_loop_has_moved_takes_the_robot_along() -> None:
    rig = located()
    moved = Pose2(0.8, -0.3, 0.1)
    rig.drive(2.0)
    scanned_ns, there = rig.now_ns, rig.truth
    rig.drive(0.4)
    before = rig.estimate
    # The fix speaks of the map of before.
    assert rig.answer(there, inserted=True, stamp_ns=scanned_ns, moved=moved) is Outcome.ACCEPTED
    after = rig.estimate
    assert after.epoch == before.epoch + 1
    assert after.map_from_base.distance_to(moved @ rig.truth) < 0.02
    assert after.odom_from_base == before.odom_from_base
    rig.drive(1.6)
    assert rig.answer(moved @ rig.truth) is Outcome.ACCEPTED
    assert rig.estimate.epoch == after.epoch
    # What is not known along one axis of the old map is not known along that axis of the new one.
    angle = 0.5 * np.pi
    rig = located()
    wide = np.diag([0.3**2, 0.02**2, 0.01**2])
    rig.localizer.place(rig.truth, wide)
    rig.answer(None, moved=Pose2(0.0, 0.0, angle))
    covariance = rig.estimate.covariance
    assert covariance[1, 1] > 50.0 * covariance[0, 0]


def test_one_outlier_moves_nothing() -> None:
    rig = located()
    rig.drive(1.0)
    before = rig.estimate
    wrong = Pose2(rig.truth.x_m + 2.0, rig.truth.y_m, rig.truth.theta_rad)
    assert rig.found((wrong, 0.9995)) is Outcome.GATED
    # Whether it was one or the robot was carried away, the next scan will tell.
    assert rig.state() is State.ODOMETRY_ONLY
    assert rig.estimate.fault == "the newest scan fits, but elsewhere: slipped, or carried?"
    assert rig.estimate.map_from_base == before.map_from_base
    assert rig.estimate.error95_m > 2.0 > before.error95_m
    assert rig.localizer.outcomes["fix.gated"] == 1
    rig.drive(1.0)
    assert rig.answer(rig.truth) is Outcome.ACCEPTED
    assert rig.state() is State.LOCALIZED
    assert rig.estimate.error95_m < 0.1
    # A later outlier does not team up with the first one.
    rig.drive(1.0)
    again = wrong @ Pose2(0.6, 0.0, 0.0)
    assert rig.found((again, 0.9995)) is Outcome.GATED
    assert rig.off_m < 0.02
    assert rig.estimate.epoch == 0


def test_scans_in_a_row_without_a_pose_are_lost_and_say_why() -> None:
    rig = located()
    for number in range(1, PARAMS.lost_refusals + 1):
        rig.drive(0.4)
        assert rig.answer(None) is Outcome.UNKNOWN
        assert rig.estimate.fault == "no such place"
        lost = number >= PARAMS.lost_refusals
        assert rig.state() is (State.LOST if lost else State.LOCALIZED)
    rig.answer(rig.truth)
    assert (rig.state(), rig.estimate.fault) == (State.LOCALIZED, None)


@pytest.mark.parametrize("pose", [Pose2(float("nan"), 0.0, 0.0), Pose2(0.0, float("inf"), 0.0)])
def test_a_fix_that_is_no_number_is_refused(pose: Pose2) -> None:
    rig = located()
    before = rig.estimate
    assert rig.answer(pose) is Outcome.INVALID
    bad = np.diag([-1.0, 1.0, 1.0])
    rig.drive(0.1)
    assert rig.answer(rig.truth, covariance=bad) is Outcome.INVALID
    assert_finite(rig.estimate)
    assert rig.off_m < 0.02
    assert rig.estimate.epoch == before.epoch


def test_silent_wheels_make_it_less_sure_then_lost_never_nan() -> None:
    rig = located()
    claims, states = [], []
    for _ in range(40):
        rig.pause(0.1)
        estimate = rig.estimate
        assert_finite(estimate)
        claims.append(estimate.error95_m)
        states.append(estimate.state)
        assert estimate.wheel_age_s == pytest.approx(0.1 * len(claims))
        if estimate.wheel_age_s > PARAMS.wheels_late_s + 0.01:
            assert "wheels silent" in str(estimate.fault)
    silent = round(10.0 * PARAMS.wheels_silent_s) + 1
    assert states[0] is State.LOCALIZED
    assert set(states[silent:]) <= {State.ODOMETRY_ONLY, State.LOST}
    assert set(states[round(10.0 * PARAMS.wheels_lost_s) + 1 :]) == {State.LOST}
    assert states == sorted(states, key=[*State].index)  # it only gets worse
    assert np.all(np.diff(claims) >= 0.0)
    assert claims[-1] > 10.0 * claims[0]
    # They speak again: their counts are sums, so nothing of the way is lost.
    rig.drive(0.1)
    assert_finite(rig.estimate)
    assert rig.state() is State.LOCALIZED
    assert rig.off_m < 0.02
    assert rig.estimate.error95_m < 2.0 * claims[0]


def test_scans_go_on_while_the_wheels_are_silent() -> None:
    rig = located()
    for _ in range(4):
        rig.pause(2.0)
        assert rig.scan() is Outcome.ACCEPTED
        request = rig.requests[-1]
        assert request.cloud.stamp_ns == rig.now_ns
        assert request.covariance is not None
        assert np.all(np.isfinite(request.covariance))
        assert request.covariance[0, 0] > 1.0  # it may have driven meanwhile
        assert rig.answer(rig.truth) is Outcome.ACCEPTED
        assert rig.off_m < 0.02
        assert_finite(rig.estimate)
    rig.drive(0.5)
    assert_finite(rig.estimate)


def test_two_scanners_make_one_request() -> None:
    rig = Rig(start=START, scanners=("front", "rear"))
    rig.drive(0.5)
    rig.scan("front")
    rig.drive(0.06)
    assert rig.requests == []  # still waiting for the other one
    rig.scan("rear")
    rig.drive(0.02)
    (request,) = rig.requests
    assert len(request.cloud) == 180
    assert request.map_from_base is not None
    # Both at the rear scan's instant: the front one's points have moved back by 1.8 cm.
    front = request.cloud.origins_m[:, 0] > 0.0
    assert request.cloud.origins_m[front, 0] == pytest.approx(0.2 - 0.06 * 0.3)
    assert request.cloud.origins_m[~front, 0] == pytest.approx(-0.2)


def test_a_silent_scanner_is_not_waited_for() -> None:
    rig = Rig(start=START, scanners=("front", "rear"))
    for number in range(1, 4):
        rig.drive(1.0)
        rig.scan("front")
        rig.drive(PARAMS.pair_wait_s + 0.04)
        assert len(rig.requests) == number
        assert len(rig.requests[-1].cloud) == 90
        rig.answer(rig.truth)


def test_one_request_at_a_time_and_the_newest_scan_wins() -> None:
    rig = located()
    rig.scan()
    for _ in range(3):
        rig.drive(1.0)
        rig.scan()
        newest_ns = rig.now_ns
    rig.drive(0.2)
    assert len(rig.requests) == 1
    rig.answer(rig.truth)
    assert [request.cloud.stamp_ns for request in rig.requests][1:] == [newest_ns]
    # The worker died with that one: the next scan must not wait for ever.
    rig.localizer.drop_request()
    rig.drive(1.0)
    rig.scan()
    rig.drive(0.2)
    assert len(rig.requests) == 3


def test_late_and_double_samples_are_said_to_be() -> None:
    rig = located()
    assert rig.scan() is Outcome.ACCEPTED
    assert rig.scan() is Outcome.DUPLICATE
    assert rig.scan(ago_s=0.1) is Outcome.LATE
    assert rig.scan("unheard of") is Outcome.INVALID
    assert rig.wheels() is Outcome.DUPLICATE
    rig.now_ns -= 10_000_000
    assert rig.wheels() is Outcome.LATE
    rig.now_ns += 10_000_000
    rig.answer(rig.truth)
    assert rig.answer(rig.truth) is not Outcome.ACCEPTED
    assert rig.answer(rig.truth, stamp_ns=0) is Outcome.LATE
    counted = rig.localizer.outcomes
    assert counted["scan.duplicate"] == counted["scan.late"] == counted["scan.invalid"] == 1
    assert counted["wheels.duplicate"] == counted["wheels.late"] == 1
    assert rig.off_m < 0.02


def test_a_late_fix_corrects_the_pose_of_now() -> None:
    """Registration took two seconds: the wheels' way since then is kept."""
    rig = located()
    rig.drive(0.5, 0.3, 0.4)
    then, then_ns = rig.truth, rig.now_ns
    rig.drive(2.0, 0.3, 0.4)
    off = Pose2(then.x_m + 0.02, then.y_m, then.theta_rad)
    assert rig.answer(off, stamp_ns=then_ns, covariance=0.1 * SURE) is Outcome.ACCEPTED
    assert rig.off_m < 1e-9  # not at once
    rig.drive(0.3, 0.3, 0.4)
    moved = rig.estimate.map_from_base
    # What one fix says of the wheels' scale and clock counts already.
    assert 0.005 < moved.x_m - rig.truth.x_m < 0.035
    assert abs(moved.y_m - rig.truth.y_m) < 0.03


def test_the_same_samples_give_the_same_estimates() -> None:
    def run() -> list[bytes]:
        rig, rng = Rig("mapping", scanners=("front", "rear")), np.random.default_rng(0)
        out = []
        for _ in range(8):
            rig.drive(0.5, 0.3, 0.3)
            rig.scan("front")
            rig.scan("rear", ago_s=0.01)
            rig.drive(0.2)
            rig.answer(rig.truth @ Pose2.exp(rng.normal(0.0, 0.005, 3)))
            estimate = rig.estimate
            out.append(estimate.map_from_base.as_array().tobytes() + estimate.covariance.tobytes())
        return out + [request.cloud.points_m.tobytes() for request in rig.requests]

    assert run() == run()


def outage_over(rig: Rig, seconds: float = 11.0) -> Pose2:
    """Fixes fail for so long; what a fix 2 m off would say now."""
    rig.drive(seconds, 0.3)
    return Pose2(rig.truth.x_m + 2.0, rig.truth.y_m, rig.truth.theta_rad)


def test_after_an_outage_the_first_fix_is_believed_as_a_new_epoch() -> None:
    rig = located()
    epoch = rig.estimate.epoch
    there = outage_over(rig)
    before = rig.estimate.map_from_base
    assert rig.answer(there) is Outcome.RESET
    estimate = rig.estimate
    assert estimate.epoch == epoch + 1
    assert estimate.map_from_base.distance_to(there) < 0.01
    assert estimate.epoch_delta is not None
    delta = estimate.map_from_base.as_array() - before.as_array()
    np.testing.assert_allclose(estimate.epoch_delta.as_array(), delta, atol=1e-9)


def test_a_wrong_fix_after_an_outage_is_taken_back_by_the_next() -> None:
    rig = located()
    epoch = rig.estimate.epoch
    assert rig.answer(outage_over(rig)) is Outcome.RESET
    rig.drive(2.0, 0.3)
    assert rig.answer(rig.truth) is Outcome.RESET
    assert rig.off_m < 0.01
    assert rig.estimate.epoch == epoch + 2


def test_two_outliers_in_a_row_do_not_move_the_published_pose() -> None:
    for size_m in (1.0, 20.0):
        rig = located()
        for _ in range(5):
            rig.drive(2.0, 0.3)
            assert rig.answer(rig.truth) is Outcome.ACCEPTED
        for _ in range(2):
            rig.drive(2.0, 0.3)
            off = Pose2(rig.truth.x_m + size_m, rig.truth.y_m, rig.truth.theta_rad)
            assert rig.answer(off) is Outcome.GATED
            assert rig.off_m < 0.01
        rig.drive(2.0, 0.3)
        assert rig.answer(rig.truth) is Outcome.ACCEPTED
        assert rig.off_m < 0.01
        assert rig.estimate.epoch_delta is None or rig.estimate.epoch == located().estimate.epoch


def test_a_spinning_wheel_is_told_and_recovered_within_two_fixes() -> None:
    rig = located()
    for _ in range(3):
        rig.drive(2.0, 0.3)
        rig.answer(rig.truth)
    for _ in range(10):  # 0.2 m of the left wheel within 0.2 s
        rig.wheels_rad += np.array([0.2, 0.0])
        rig.drive(0.02, 0.3)
    rig.drive(1.0, 0.3)
    outcomes = []
    for _ in range(3):
        outcomes.append(rig.answer(rig.truth))
        rig.drive(2.0, 0.3)
    assert outcomes[1] in {Outcome.INFLATED, Outcome.ACCEPTED}
    assert outcomes[2] is Outcome.ACCEPTED
    assert rig.off_m < 0.02
    events = rig.localizer.wheel_events
    assert events
    assert "wheel" in (rig.estimate.fault or "")
    assert rig.localizer.calibration is not None
