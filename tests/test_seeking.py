"""A pose that somebody names: sought, taken as is, or forgotten; and another map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from localizer_rig import SURE, Rig

from amr_slam.geometry import Pose2
from amr_slam.inspection import Inspection, Looks
from amr_slam.region import Region
from amr_slam.samples import Outcome, State

START = Pose2(2.0, 1.0, 0.5)
THERE = Pose2(8.0, -3.0, -2.0)
REGION = Region(map_from_base=THERE, radius_m=2.0, heading_rad=1.0)


def located() -> Rig:
    rig = Rig(start=START)
    rig.drive(0.5)
    assert rig.answer(rig.truth) is Outcome.ACCEPTED
    return rig


def asked(rig: Rig) -> Region | None:
    """The region in which the next scan is sought."""
    rig.scan()
    rig.drive(0.2)
    return rig.requests[-1].region


def test_two_scans_that_agree_confirm_a_named_pose() -> None:
    rig = located()
    seek = rig.localizer.seek(REGION)
    region = asked(rig)
    assert region is not None
    assert region.radius_m == REGION.radius_m
    driven = rig.truth
    assert rig.sought(THERE) is Outcome.UNKNOWN
    assert not seek.ended
    assert (rig.estimate.epoch, rig.state()) == (0, State.LOCALIZED)
    assert rig.off_m < 0.02  # nothing has moved yet
    rig.drive(1.0)
    region = asked(rig)
    way = driven.inverse() @ rig.truth
    assert region is not None
    # The region goes with the robot.
    assert region.map_from_base.distance_to(THERE @ way) < 0.15
    assert rig.sought(THERE @ way) is Outcome.RESET
    assert seek.ended
    assert seek.pose == THERE @ way
    assert (rig.estimate.epoch, rig.state()) == (1, State.LOCALIZED)
    assert rig.estimate.map_from_base.distance_to(THERE @ way) < 0.01
    assert asked(rig) is None


def test_what_does_not_fit_leaves_the_pose_as_it_was() -> None:
    rig = located()
    seek = rig.localizer.seek(REGION)
    for _ in range(2):
        assert asked(rig) is not None
        assert rig.sought(None) is Outcome.UNKNOWN
    assert (seek.ended, seek.pose, seek.reason) == (True, None, "only 30% fit")
    assert rig.estimate.fault is None  # that was said of another place
    assert (rig.estimate.epoch, rig.state()) == (0, State.LOCALIZED)
    assert rig.off_m < 0.02
    assert asked(rig) is None
    assert rig.answer(rig.truth) is Outcome.ACCEPTED


def test_one_scan_full_of_passers_by_does_not_end_the_search() -> None:
    rig = located()
    seek = rig.localizer.seek(replace(REGION, map_from_base=rig.truth))
    for found in (None, rig.truth, rig.truth):
        assert not seek.ended
        assert asked(rig) is not None
        rig.sought(found if found is None else rig.truth)
    assert seek.pose is not None


def test_scans_that_contradict_each_other_confirm_nothing() -> None:
    rig = located()
    seek = rig.localizer.seek(REGION)
    for step in range(3):
        assert asked(rig) is not None
        rig.sought(THERE @ Pose2(0.9 * step, 0.0, 0.0))
    assert seek.ended
    assert seek.pose is None
    assert "another place" in (seek.reason or "")
    assert rig.estimate.epoch == 0


def test_a_search_that_was_given_up_is_not_heard_any_more() -> None:
    rig = located()
    seek = rig.localizer.seek(REGION)
    asked(rig)
    seek.give_up("too late")
    assert rig.sought(THERE) is Outcome.UNKNOWN
    assert rig.sought(THERE) is Outcome.UNKNOWN
    assert rig.estimate.epoch == 0
    assert asked(rig) is None


def test_a_pose_taken_as_is_is_a_new_epoch_and_not_localized_before_a_scan_agrees() -> None:
    rig = located()
    rig.localizer.place(THERE, 100.0 * SURE)
    assert rig.estimate.map_from_base.distance_to(THERE) < 1e-9
    assert (rig.estimate.epoch, rig.state()) == (1, State.ODOMETRY_ONLY)
    rig.drive(0.5)
    assert rig.state() is State.ODOMETRY_ONLY
    here = rig.estimate.map_from_base
    assert rig.answer(here) is Outcome.ACCEPTED
    assert rig.state() is State.LOCALIZED


def test_a_pose_that_is_forgotten_is_lost_at_once_and_claims_nothing() -> None:
    rig = located()
    odom = rig.estimate.odom_from_base
    rig.localizer.forget()
    assert (rig.estimate.epoch, rig.state()) == (1, State.LOST)
    assert rig.estimate.error95_m > 1e3
    assert rig.estimate.odom_from_base == odom
    rig.scan()
    rig.drive(0.2)
    assert rig.requests[-1].map_from_base is None
    assert rig.requests[-1].motion is None


def test_another_map_is_another_epoch_and_the_wheels_go_on() -> None:
    rig = located()
    odom = rig.estimate.odom_from_base
    seek = rig.localizer.seek(REGION)
    rig.localizer.restart("mapping")
    assert seek.reason == "the map has been changed"
    assert rig.estimate.map_from_base.distance_to(Pose2.identity()) < 1e-9
    assert (rig.estimate.epoch, rig.state()) == (1, State.STARTING)
    assert rig.estimate.odom_from_base == odom
    assert rig.localizer.objection() is not None
    assert rig.answer(None, inserted=True) is Outcome.ACCEPTED
    assert rig.state() is State.MAPPING
    rig.localizer.restart("localization")
    assert rig.localizer.objection() is None
    assert rig.estimate.epoch == 2
    assert rig.estimate.error95_m > 1e3
    rig.scan()
    rig.drive(0.2)
    assert rig.requests[-1].map_from_base is None


def test_a_newer_version_of_the_map_keeps_the_pose_until_a_scan_agrees() -> None:
    rig = located()
    before = rig.estimate
    rig.localizer.restart("localization", keeps_pose=True)
    after = rig.estimate
    assert after.map_from_base.distance_to(before.map_from_base) < 1e-9
    assert (after.epoch, after.state) == (before.epoch + 1, State.ODOMETRY_ONLY)
    assert after.error95_m < 2.0 * before.error95_m + 0.1
    rig.scan()
    rig.drive(0.2)
    assert rig.requests[-1].map_from_base is not None


def test_no_pose_is_set_without_wheels_or_with_scanners_that_are_mounted_otherwise() -> None:
    rig = located()
    assert rig.localizer.objection() is None
    wrong = Inspection(looks=Looks.WRONG, fault="front scanner looks mirrored")
    for _ in range(3):
        rig.localizer._suspicions.hear(wrong)
    assert rig.localizer.objection() == "scanner configuration: front scanner looks mirrored"


@pytest.mark.parametrize(
    ("pose", "held"),
    [
        (Pose2(9.9, -3.0, -2.0), True),
        (Pose2(11.0, -3.0, -2.0), False),
        (Pose2(8.0, -3.0, math.pi - 0.2), True),  # across the cut of angles
        (Pose2(8.0, -3.0, 1.0), False),
    ],
)
def test_a_region_holds_poses_near_it(pose: Pose2, held: bool) -> None:
    region = replace(REGION, map_from_base=replace(THERE, theta_rad=-2.5))
    assert region.holds(pose) is held
    assert np.isfinite(pose.as_array()).all()
