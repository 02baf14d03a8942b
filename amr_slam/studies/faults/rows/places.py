"""Rows 24 to 26: the robot and the place do not go together."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from amr_slam.samples import Scan
from amr_slam.simulation import blocked
from amr_slam.states import State
from amr_slam.studies.faults.judging import Times, figures, states_of
from amr_slam.studies.faults.row import Case, Finding, Row, either, state_is
from amr_slam.studies.faults.rows.scanners import disturbed
from amr_slam.studies.faults.settings import Setting
from amr_slam.studies.faults.stage import Stage, is_well
from amr_slam.studies.faults.witness import Message
from amr_slam.wire import PoseMessage

DOUBTS: Final = state_is(State.LOST, State.AMBIGUOUS, State.ODOMETRY_ONLY)
"""Does not claim to be where it was thought to be."""
_CARRIED_M: Final = 12.0
_CROWD: Final = 0.8
_ALIKE_S: Final = 16.0


@contextmanager
def _kidnapped(stage: Stage) -> Iterator[None]:
    stage.robot.carry(_CARRIED_M)
    yield


@contextmanager
def _crowd(stage: Stage) -> Iterator[None]:
    dice = np.random.default_rng(5)

    def stand_in_the_way(scan: Scan) -> Scan:
        return blocked(scan, dice, _CROWD, 0.01)

    with disturbed(stage, stand_in_the_way):
        yield


def _complains(message: Message) -> bool:
    return isinstance(message, PoseMessage) and not is_well(message)


def _alike(case: Case, make: Callable[[Setting], Stage]) -> Finding:
    """From nothing, where every place has a twin."""
    setting = Setting(place="alike")
    with make(setting) as stage:
        says = state_is(State.AMBIGUOUS)
        located = either(says, state_is(State.LOST, State.LOCALIZED))
        begun = stage.witness.wait_for(located, 0, 120.0)
        begin_ns = 0 if begun is None else begun.received_ns
        sign = stage.witness.wait_for(says, begin_ns, 2.0 * case.within_s + 1.0)
        stage.rest(_ALIKE_S)
        heard = stage.witness.since(begin_ns)
        last_ns = heard[-1].received_ns if heard else begin_ns
        times = Times(
            calm_ns=begin_ns, onset_ns=begin_ns, end_ns=last_ns, back_ns=None,
            due_ns=begin_ns,
        )  # fmt: skip
        found = figures(heard, stage.robot.truth(begin_ns), times)
    detected_s = None if sign is None else 1e-9 * (sign.received_ns - begin_ns)
    broken = list(found.broken)
    if detected_s is None or detected_s > case.within_s:
        broken.append("not called ambiguous in time")
    return Finding(
        number=case.number, fault=case.fault, sign=case.sign, detected_s=detected_s,
        deadline_s=case.within_s, states=states_of(heard, begin_ns), said="",
        recovered_s=None, worst_m=found.worst_m, unsaid_m=found.unsaid_m, beyond=found.beyond,
        gap_max_ms=found.gap_max_ms, gap_p99_ms=found.gap_p99_ms, broken=tuple(broken),
        elsewhere=case.elsewhere,
    )  # fmt: skip


PLACES: Final = (
    Row(
        number="24", fault=f"kidnapped: set down {_CARRIED_M:g} m further along", inject=_kidnapped,
        sign="fault: the newest scan fits elsewhere; or lost, ambiguous", says=DOUBTS,
        within_scans=3,
        back_scans=6,
    ),
    Case(
        number="25", fault="started where every place has a twin", sign="ambiguous", within_s=2.0,
        play=_alike, elsewhere="corridors: docs/evaluation-evidence.md",
    ),
    Row(
        number="26", fault=f"crowd: {100 * _CROWD:.0f} % of all beams blocked", inject=_crowd,
        sign="fault, or no fix any more", says=_complains, within_scans=1, within_s=0.5,
        lasts_s=8.0, back_scans=3,
    ),
)  # fmt: skip
