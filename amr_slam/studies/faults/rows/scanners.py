"""Rows 1 to 8, 17 and 31: what happens on a scanner's line, and before its window."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np

from amr_slam.samples import Scan
from amr_slam.states import State
from amr_slam.studies.faults.row import Row, either, fault_says, state_is
from amr_slam.studies.faults.stage import Stage, is_localized
from amr_slam.studies.faults.witness import Message
from amr_slam.wire import StatusMessage

GOES_ON: Final = frozenset({State.LOCALIZED})
POSE_S: Final = 0.04
"""What a pose may take from its instant to the fleet, with the one that has just gone."""
_LATE_S: Final = 0.4
_NOISE_S: Final = 0.02
_NOISE_BYTES: Final = 1000


@contextmanager
def disturbed(stage: Stage, disturb: Callable[[Scan], Scan | None]) -> Iterator[None]:
    """Each scan suffers this meanwhile."""
    stage.robot.surroundings.disturb_scan = disturb
    try:
        yield
    finally:
        stage.robot.surroundings.disturb_scan = lambda scan: scan


@contextmanager
def _cut(stage: Stage) -> Iterator[None]:
    left = iter([300])

    def last_words(scan: Scan) -> Scan | None:
        if scan.scanner != "front":
            return scan
        for at_byte in left:
            stage.robot.scanners["front"].cut_next(at_byte)
            stage.mark()
            return scan
        return None

    with disturbed(stage, last_words):
        yield


@contextmanager
def _noise(stage: Stage) -> Iterator[None]:
    front, stop = stage.robot.scanners["front"], threading.Event()
    dice = random.Random(1)

    def rattle() -> None:
        while not stop.wait(_NOISE_S):
            front.send_bytes(dice.randbytes(_NOISE_BYTES))

    noise = threading.Thread(target=rattle)
    with disturbed(stage, lambda scan: None if scan.scanner == "front" else scan):
        noise.start()
        try:
            yield
        finally:
            stop.set()
            noise.join()


@contextmanager
def _damaged(stage: Stage) -> Iterator[None]:
    dice = random.Random(2)

    def damage(scan: Scan) -> Scan:
        if scan.scanner == "front" and dice.random() < 0.3:
            stage.robot.scanners["front"].damage_next(dice.randrange(1 << 16))
        return scan

    with disturbed(stage, damage):
        yield


@contextmanager
def _frozen(stage: Stage) -> Iterator[None]:
    """The same picture under new numbers: the scanner's counter does not tell."""
    first: list[Scan] = []

    def freeze(scan: Scan) -> Scan:
        if scan.scanner != "rear":
            return scan
        first.append(scan)
        return replace(scan, ranges_m=first[0].ranges_m)

    with disturbed(stage, freeze):
        yield


@contextmanager
def _mirrored(stage: Stage) -> Iterator[None]:
    def mirror(scan: Scan) -> Scan:
        if scan.scanner != "rear":
            return scan
        return replace(scan, ranges_m=scan.ranges_m[::-1])

    with disturbed(stage, mirror):
        yield


def _silent(*names: str) -> Callable[[Stage], Iterator[None]]:
    def inject(stage: Stage) -> Iterator[None]:
        for name in names:
            stage.robot.scanners[name].silent = True
        try:
            yield
        finally:
            for name in names:
                stage.robot.scanners[name].silent = False

    return inject


@contextmanager
def _unplugged(stage: Stage) -> Iterator[None]:
    stage.robot.scanners["front"].unplug()
    try:
        yield
    finally:
        stage.robot.scanners["front"].replug()


@contextmanager
def _late(stage: Stage) -> Iterator[None]:
    front = stage.robot.scanners["front"]
    waiting: list[threading.Timer] = []

    def hold(scan: Scan) -> Scan | None:
        if scan.scanner != "front":
            return scan
        waiting.append(threading.Timer(_LATE_S, front.measure, [scan.ranges_m]))
        waiting[-1].start()
        return None

    with disturbed(stage, hold):
        yield
    for timer in waiting:
        timer.join()


@contextmanager
def _no_numbers(stage: Stage) -> Iterator[None]:
    with disturbed(stage, lambda s: replace(s, ranges_m=np.full_like(s.ranges_m, np.nan))):
        yield


def _tells_damage(message: Message) -> bool:
    if not isinstance(message, StatusMessage):
        return False
    return "telegrams damaged" in (message.scanners["front"].detail or "")


@contextmanager
def _nothing(_stage: Stage) -> Iterator[None]:
    yield


SCANNERS: Final = (
    Row(
        number="0", fault="none, to compare", inject=_nothing, sign="", lasts_s=10.0,
        stays=GOES_ON,
    ),
    Row(
        number="1", fault="scanner's cable cut in the middle of a telegram", inject=_cut,
        sign="fault: front stale", says=fault_says("front stale"), within_s=0.5 + POSE_S,
        stays=GOES_ON,
    ),
    Row(
        number="2", fault="50 kB/s of noise on a scanner's line", inject=_noise,
        sign="fault: front stale", says=fault_says("front stale"), within_s=1.0, stays=GOES_ON,
    ),
    Row(
        number="3", fault="30 % of a scanner's telegrams damaged", inject=_damaged,
        sign="health: telegrams damaged", says=_tells_damage, within_s=10.0, back=is_localized,
        stays=GOES_ON,
    ),
    Row(
        number="4", fault="scanner frozen, its counter goes on", inject=_frozen,
        sign="fault: rear scanner frozen", says=fault_says("rear scanner frozen"), within_scans=3,
        stays=GOES_ON,
    ),
    Row(
        number="5", fault="scanner mirrored", inject=_mirrored,
        sign="fault: scanner configuration; lost", within_scans=5,
        says=fault_says("scanner configuration"), back_scans=4,
    ),
    Row(
        number="6", fault="one scanner silent", inject=contextmanager(_silent("rear")),
        sign="fault: rear stale", says=fault_says("rear stale"), within_s=0.5 + POSE_S,
        stays=GOES_ON,
    ),
    Row(
        number="7", fault="both scanners silent for 22 s",
        inject=contextmanager(_silent("front", "rear")),
        sign="odometry_only", says=state_is(State.ODOMETRY_ONLY, State.LOST), within_s=5.0,
        lasts_s=22.0, back_scans=3,
    ),
    Row(
        number="8", fault="a scanner's port gone and back", inject=_unplugged,
        sign="fault: front lost", says=fault_says("front lost"), within_s=0.5, stays=GOES_ON,
        elsewhere="USB adapter of a real kernel",
    ),
    Row(
        number="17", fault=f"a scanner's telegrams late by {_LATE_S:g} s", inject=_late,
        sign="fault: front stale", within_scans=5,
        stays=frozenset({State.LOCALIZED, State.ODOMETRY_ONLY}),
        says=either(fault_says("front stale"), fault_says("front scanner missing")),
        back_s=10.0,  # so long the line is held to be damaged, after the last late telegram
    ),
    Row(
        number="31", fault="no finite range in any scan", inject=_no_numbers,
        sign="odometry_only", says=state_is(State.ODOMETRY_ONLY), within_s=5.0,
    ),
)  # fmt: skip
