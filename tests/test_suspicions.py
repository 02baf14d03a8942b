from __future__ import annotations

from amr_slam.inspection import Inspection, Looks
from amr_slam.suspicions import Suspicions

RIGHT = Inspection(looks=Looks.RIGHT)
RIGHT_BY_MOTION = Inspection(looks=Looks.RIGHT, by_motion=True)
UNTOLD = Inspection()
MIRRORED = Inspection(looks=Looks.WRONG, fault="mirrored")
TURNED = Inspection(looks=Looks.WRONG, fault="turned")
SWAPPED = Inspection(looks=Looks.WRONG, fault="swapped", by_motion=True)


def heard(*inspections: Inspection) -> Suspicions:
    suspicions = Suspicions()
    for one in inspections:
        suspicions.hear(one)
    return suspicions


def test_three_of_five_scans_that_name_the_same_fault_make_it_known() -> None:
    assert heard(MIRRORED, MIRRORED).fault is None
    assert heard(MIRRORED, UNTOLD, MIRRORED, RIGHT, MIRRORED).fault == "mirrored"
    assert heard(MIRRORED, UNTOLD, UNTOLD, MIRRORED, UNTOLD, MIRRORED).fault is None
    assert heard(MIRRORED, TURNED, MIRRORED, TURNED).fault is None


def test_two_ways_against_the_wheels_are_enough_and_the_first_is_in_doubt() -> None:
    once = heard(SWAPPED)
    assert once.doubtful
    assert once.fault is None
    assert heard(SWAPPED, UNTOLD, SWAPPED).fault == "swapped"
    assert not heard(SWAPPED, RIGHT).doubtful
    assert not heard(MIRRORED).doubtful


def test_no_fix_is_used_of_a_scan_that_looks_wrong_nor_while_the_fault_is_told() -> None:
    assert heard(RIGHT).withholds(MIRRORED)
    assert not heard(MIRRORED, MIRRORED).withholds(RIGHT)
    assert heard(MIRRORED, MIRRORED, MIRRORED).withholds(RIGHT)


def test_two_right_scans_in_a_row_end_a_fault() -> None:
    told = heard(MIRRORED, MIRRORED, MIRRORED, RIGHT, MIRRORED, RIGHT)
    assert told.fault == "mirrored"
    told.hear(RIGHT)
    assert told.fault is None
    # ... and it needs three scans to come back.
    told.hear(MIRRORED)
    assert told.fault is None


def test_a_fault_like_another_pose_is_ended_by_motion_only() -> None:
    told = heard(SWAPPED, SWAPPED)
    assert told.by_motion
    for _ in range(5):
        told.hear(RIGHT)
    assert told.fault == "swapped"
    told.hear(RIGHT_BY_MOTION)
    told.hear(RIGHT)
    told.hear(RIGHT_BY_MOTION)
    assert told.fault is None
