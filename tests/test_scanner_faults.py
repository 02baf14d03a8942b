"""Faults of the scanners of a simulated robot, through the real localizer and engine: found in
time, named, nothing wrong claimed, and over after the repair."""

from __future__ import annotations

import functools
import subprocess
import sys

import pytest
from paths import REPO

from amr_slam.map import PointMap
from amr_slam.samples import State
from amr_slam.simulation import Tour, World
from amr_slam.studies.scanner_faults import (
    FAULTS,
    Fault,
    Run,
    clean,
    false_alarms,
    find,
    scene,
)

TOOL = str(REPO / "tools" / "scanner_faults.py")
BY_NAME = {fault.name: fault for fault in FAULTS}
# The others are in the tables of tools/scanner_faults.py.
ON_THE_WAY = (
    "rear dead",
    "rear frozen",
    "rear mirrored",
    "front turned by 180 deg",
    "swapped, unlike mountings",
    "one scanner, mirrored",
)
AT_THE_START = ("rear mirrored", "rear turned by 90 deg", "swapped, unlike mountings")
# Only the way of the robot tells these from another pose, once it has gone far enough.
BY_MOTION = ("swapped, mountings half a turn apart", "one scanner, turned by 180 deg")


@functools.cache
def known() -> tuple[World, PointMap, Tour]:
    return scene("laboratory", 3)


@pytest.mark.parametrize("name", ON_THE_WAY)
def test_a_fault_on_the_way_is_found_and_named_within_five_scans(name: str) -> None:
    found = find(BY_NAME[name], known(), at_start=False, seed=3, periods=5)
    assert found.after is not None, name
    assert found.after <= 5
    assert found.right, found.named
    assert found.worst_m < 0.05
    assert found.back_after is not None
    assert found.back_after <= 4


@pytest.mark.parametrize("name", AT_THE_START)
def test_a_fault_from_the_start_is_found_and_named_within_five_scans(name: str) -> None:
    found = find(BY_NAME[name], known(), at_start=True, seed=3, periods=5)
    assert found.after is not None, name
    assert found.after <= 5
    assert found.right, found.named
    assert found.worst_m < 0.05
    assert found.back_after is not None


@pytest.mark.parametrize("name", BY_MOTION)
def test_a_fault_like_another_pose_shows_on_the_way(name: str) -> None:
    found = find(BY_NAME[name], known(), at_start=True, seed=3, periods=9)
    assert found.after is not None
    assert found.after <= 6
    assert found.right, found.named
    assert found.worst_m < 0.05
    assert found.back_after is not None


def test_both_scanners_dead_end_in_odometry_and_then_in_lost() -> None:
    """Rows 6 and 7: five seconds after the last fix, and when the wheels alone are too unsure."""
    fault = Fault(
        name="both dead", word="missing", source=lambda name: name, disturb=lambda: lambda _: None
    )
    run = Run(*known(), fault, located=True, seed=3)
    for moment in run.periods(2):
        assert moment.said.state is State.LOCALIZED
    run.begin_fault()
    said = [moment.said for moment in run.periods(12)]
    assert [one.state for one in said[2:6]] == [State.ODOMETRY_ONLY] * 4
    assert said[-1].state is State.LOST
    assert "front scanner missing; rear scanner missing" in (said[4].fault or "")
    grown = [one.error95_m for one in said]
    assert grown == sorted(grown)
    run.repair()
    assert [moment.said.state for moment in run.periods(3)][-1] is State.LOCALIZED


def test_one_scanner_alone_goes_on_and_claims_less() -> None:
    nothing = Fault(name="none", word="", source=lambda name: name, disturb=lambda: lambda s: s)
    run, well = (
        Run(*known(), fault, located=True, seed=3) for fault in (BY_NAME["rear dead"], nothing)
    )
    for one in (run, well):
        list(one.periods(3))
        one.begin_fault()
    alone = [moment.said for moment in run.periods(8)]
    both = [moment.said for moment in well.periods(8)]
    assert all(one.state is State.LOCALIZED for one in alone)
    assert alone[-1].error95_m > both[-1].error95_m
    assert alone[-1].fault == "rear scanner missing"
    assert run.worst_m < 0.05


@pytest.mark.parametrize("scanners", [1, 2])
def test_people_moved_furniture_and_blocked_beams_are_no_fault(scanners: int) -> None:
    run = clean("laboratory", 3, "everything", located=True, scanners=scanners)
    assert false_alarms(run, 12) == (12, 0, 0)


def test_a_new_map_is_not_founded_on_scanners_that_contradict_each_other() -> None:
    fault = BY_NAME["rear mirrored"]
    run = Run(*known(), fault, located=False, mapping=True, seed=3)
    run.begin_fault()
    said = [moment.said for moment in run.periods(4)]
    assert len(run.engine.map.path) == 0
    assert said[-1].state is State.LOST
    assert "mirrored" in (said[-1].fault or "")
    run.repair()
    assert [moment.said.state for moment in run.periods(4)][-1] is State.MAPPING
    assert len(run.engine.map.path) > 0


def test_a_swap_that_looks_like_a_half_turn_is_claimed_wrongly_by_who_never_moved() -> None:
    """What docs/scanner-faults.md admits: the second scan on the way ends it."""
    run = Run(*known(), BY_NAME[BY_MOTION[0]], located=False, seed=3)
    run.begin_fault()
    standing = [moment.said.state for moment in run.periods(4, stand=True)]
    assert standing[-1] is State.LOCALIZED
    driven = [moment.said for moment in run.periods(4)]
    assert [one.state for one in driven[1:]] == [State.LOST] * 3
    assert "front and rear look swapped" in (driven[-1].fault or "")


def test_the_tool_prints_the_table() -> None:
    arguments = ["--worlds", "hall", "--seeds", "21", "--periods", "1", "--begins", "on the way"]
    done = subprocess.run(
        [sys.executable, TOOL, *arguments, "--clean"], capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert lines[0] == "**Faults**"
    assert sum(line.startswith("| ") for line in lines) == 1 + len(FAULTS)
