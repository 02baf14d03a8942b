"""What the localizer must not take in: too early, too late, repeated, mismounted, or no number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from localizer_rig import DRIVE, PARAMS, SURE, Rig, answer_of

from amr_slam.clouds import CloudParams
from amr_slam.evidence import unknown
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.inspection import Inspection, Looks
from amr_slam.localizer import Localizer, Mounting
from amr_slam.region import Region
from amr_slam.samples import Outcome, Scan, SlamPose, State, WheelSample

START = Pose2(2.0, 1.0, 0.5)
MIRRORED = Inspection(looks=Looks.WRONG, fault="front scanner looks mirrored")
SWAPPED = Inspection(looks=Looks.WRONG, fault="scanners look swapped", by_motion=True)
RIGHT = Inspection(looks=Looks.RIGHT, by_motion=True)
PAST_S = 2.0 * FilterParams().history_s
"""Nothing of what was before is known any more."""


def located() -> Rig:
    rig = Rig(start=START)
    rig.drive(0.5)
    assert rig.answer(rig.truth) is Outcome.ACCEPTED
    return rig


def fix_of(rig: Rig, pose: Pose2) -> SlamPose:
    return SlamPose(stamp_ns=rig.now_ns, map_from_base=pose, covariance=SURE)


# -- before the first wheel sample ---------------------------------------------------------------


def test_a_map_may_be_chosen_before_wheels_come_and_a_pose_may_not() -> None:
    mountings = {"front": Mounting(base_from_lidar=Pose2.identity())}
    localizer = Localizer(
        PARAMS, FilterParams(), CloudParams(), DRIVE, mountings, "localization", (START, SURE)
    )
    assert localizer.objection() == "no wheel sample has come yet"
    rig = Rig()
    rig.answer(START)
    early = rig.localizer.last_result
    assert early is not None
    assert localizer.handle(early) is Outcome.UNKNOWN
    localizer.restart("mapping")
    sample = WheelSample(stamp_ns=1_000_000_000, left_rad=0.0, right_rad=0.0)
    assert localizer.handle(sample) is Outcome.ACCEPTED
    # The new map begins where the robot stands; START was of the map before.
    estimate = localizer.estimate(sample.stamp_ns)
    assert estimate is not None
    assert estimate.map_from_base == Pose2.identity()
    assert estimate.state is State.STARTING
    assert "while mapping" in str(localizer.objection())


# -- scans that say nothing ----------------------------------------------------------------------


def test_a_scan_that_is_repeated_while_the_robot_drives_is_asked_about_no_more() -> None:
    rig = located()
    ranges_m = 3.0 + rig.noise.normal(0.0, 0.01, 90)
    outcomes = []
    for _ in range(4):
        rig.drive(1.0)
        scan = Scan(
            scanner="front",
            stamp_ns=rig.now_ns,
            ranges_m=ranges_m,
            angle_min_rad=-0.4,
            angle_step_rad=0.01,
        )
        outcomes.append(rig.localizer.handle(scan))
        rig.collect()
        asked = len(rig.requests)
        rig.answer(rig.truth)
    assert outcomes == [Outcome.ACCEPTED, *3 * [Outcome.FROZEN]]
    assert asked == 1
    assert "front scanner frozen" in str(rig.estimate.fault)
    rig.drive(1.0)
    rig.scan()
    assert "frozen" not in str(rig.estimate.fault)


def test_a_scan_is_placed_on_the_wheels_clock() -> None:
    lag_s = 0.3
    mounting = Mounting(base_from_lidar=Pose2.identity(), lag_s=lag_s)
    rig = Rig(start=START)
    rig.localizer = Localizer(
        PARAMS,
        FilterParams(),
        CloudParams(),
        DRIVE,
        {"front": mounting},
        "localization",
        (START, SURE),
    )
    rig.wheels()
    rig.drive(1.0)
    then = rig.truth
    rig.drive(lag_s)
    assert rig.scan() is Outcome.ACCEPTED  # stamped now, measured then
    prior = rig.requests[-1].map_from_base
    assert prior is not None
    assert prior.distance_to(then) < 1e-6


# -- answers of another time ---------------------------------------------------------------------


def test_a_moved_map_of_long_ago_moves_nothing() -> None:
    rig = located()
    rig.drive(PAST_S)
    before = rig.estimate
    assert rig.answer(None, stamp_ns=0, moved=Pose2(3.0, 0.0, 0.0)) is Outcome.UNKNOWN
    assert rig.estimate.map_from_base == before.map_from_base
    assert rig.estimate.epoch == before.epoch


def test_what_a_lost_robot_hears_too_late_does_not_place_it() -> None:
    rig = Rig()
    rig.drive(PAST_S)
    for stamp_ns in (0, 1):
        assert rig.answer(START, relocalized=True, stamp_ns=stamp_ns) is not Outcome.RESET
        assert rig.found((START, 0.99), stamp_ns=stamp_ns) is not Outcome.RESET
    assert rig.state() is State.LOST
    assert not rig.estimate.candidates
    # The same in time does.
    rig.found((START, 0.99))
    rig.drive(1.0)
    assert rig.found((START @ Pose2(0.3, 0.0, 0.0), 0.99)) is Outcome.RESET
    assert rig.state() is State.LOCALIZED


def test_places_that_the_wheels_cannot_carry_any_further_are_not_told() -> None:
    rig = Rig()
    rig.drive(0.5)
    rig.found((START, 0.5), (Pose2(9.0, 1.0, 0.5), 0.5))
    assert len(rig.estimate.candidates) == 2
    rig.drive(PAST_S)
    assert not rig.estimate.candidates


# -- a pose that somebody names ------------------------------------------------------------------


def test_a_search_ends_where_the_wheels_have_forgotten_its_beginning() -> None:
    rig = located()
    seek = rig.localizer.seek(Region(map_from_base=START, radius_m=2.0, heading_rad=1.0))
    rig.drive(PAST_S)
    rig.scan()
    assert seek.ended
    assert seek.pose is None
    assert "do not know the way" in str(seek.reason)
    assert rig.requests[-1].region is None
    # Nobody hears of a search that has ended, whoever gives it up.
    rig.localizer.abandon(seek, "nobody waits")
    assert "do not know the way" in str(seek.reason)


def test_a_search_that_is_abandoned_or_replaced_says_so() -> None:
    rig = located()
    region = Region(map_from_base=START, radius_m=2.0, heading_rad=1.0)
    first = rig.localizer.seek(region)
    second = rig.localizer.seek(region)
    assert "another pose has been named" in str(first.reason)
    rig.localizer.abandon(first, "late")
    assert not second.ended
    rig.localizer.abandon(second, "nobody waits")
    assert second.reason == "nobody waits"
    assert rig.sought(START) is Outcome.UNKNOWN  # its answer comes all the same


def test_a_found_pose_that_is_no_number_is_not_taken() -> None:
    rig = located()
    before = rig.estimate
    seek = rig.localizer.seek(Region(map_from_base=START, radius_m=2.0, heading_rad=1.0))
    broken = replace(fix_of(rig, START), covariance=np.full((3, 3), np.nan))
    outcomes = [rig.hand_back(unknown(""), broken, sought=True) for _ in range(2)]
    assert outcomes == [Outcome.UNKNOWN, Outcome.INVALID]
    assert seek.ended
    assert "cannot be taken" in str(seek.reason)
    assert rig.off_m < 1e-9
    assert rig.estimate.epoch == before.epoch


# -- scanners mounted otherwise ------------------------------------------------------------------


def test_fixes_of_a_mirrored_scanner_are_not_used() -> None:
    rig = located()
    off = Pose2(0.04, 0.0, 0.0)  # near enough to be a correction
    for _ in range(3):
        rig.drive(1.0)
        fix = fix_of(rig, rig.truth @ off)
        outcome = rig.hand_back(answer_of((rig.truth, 0.99)), fix, inspection=MIRRORED)
        assert outcome is Outcome.MISMOUNTED
    rig.drive(0.5)
    assert rig.off_m < 1e-6
    assert "scanner configuration: front scanner looks mirrored" in str(rig.estimate.fault)
    assert "scanner configuration" in str(rig.localizer.objection())
    assert rig.state() is State.LOST


def test_a_fault_that_looked_like_another_pose_has_the_robot_sought_anew() -> None:
    rig = located()
    rig.scan()
    assert rig.requests[-1].map_from_base is not None
    for _ in range(2):
        rig.hand_back(unknown("nothing fits"), None, inspection=SWAPPED)
        rig.drive(1.0)
    rig.scan()
    assert rig.requests[-1].map_from_base is None  # in the whole map, near no expected pose
    for _ in range(2):
        rig.hand_back(unknown("nothing fits"), None, inspection=RIGHT)
    assert rig.localizer.objection() is None


# -- wheels --------------------------------------------------------------------------------------


@pytest.mark.parametrize("wheel", ["left", "right"])
def test_a_wheel_that_comes_to_stand_at_once_is_told_and_makes_the_pose_unsure(wheel: str) -> None:
    stuck = Rig(start=START)
    sound = Rig(start=START)
    for rig in (stuck, sound):
        rig.drive(1.0, 0.8)
    stands_rad = stuck.wheels_rad[0 if wheel == "left" else 1]
    for _ in range(25):
        for rig in (stuck, sound):
            rig.now_ns += 20_000_000
            rig.wheels_rad += 0.16
        counts_rad = dict(zip(("left", "right"), stuck.wheels_rad, strict=True))
        counts_rad[wheel] = stands_rad
        stuck.localizer.handle(
            WheelSample(
                stamp_ns=stuck.now_ns, left_rad=counts_rad["left"], right_rad=counts_rad["right"]
            )
        )
        sound.wheels()
    told = [event.text for event in stuck.localizer.wheel_events]
    assert [text for text in told if f"{wheel} wheel stuck" in text] == told[:1]
    assert sound.localizer.wheel_events == ()
    assert stuck.estimate.covariance[2, 2] > 100.0 * sound.estimate.covariance[2, 2]
