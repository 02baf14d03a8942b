"""Plays a row: a calm drive, the fault, the way back, and a calm drive again."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from amr_slam.studies.faults.judging import Times, figures, states_of
from amr_slam.studies.faults.processes import open_files
from amr_slam.studies.faults.row import Finding, Row
from amr_slam.studies.faults.stage import Stage
from amr_slam.studies.faults.witness import Heard, Presence
from amr_slam.wire import StatusMessage

_BUSY_S: Final = 0.2
"""So much lateness of the emulated robot is worth a word."""
PATIENCE: Final = 2.0
"""How much longer than its deadline is waited for a sign, to tell by how much it is missed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Before:
    """What is compared with the same afterwards."""

    refused: int
    files: int
    paused_s: float

    @staticmethod
    def of(stage: Stage) -> _Before:
        return _Before(
            refused=stage.witness.refused,
            files=open_files(stage.daemon.pid),
            paused_s=stage.robot.surroundings.paused_s,
        )


def play(row: Row, stage: Stage, patience: float = PATIENCE) -> Finding:
    """``patience``: so many deadlines are waited for.

    Raises StageError when the robot is not well to begin with.
    """
    stage.settle()
    stage.onset_ns, stage.notes, stage.broken = None, [], []
    before = _Before.of(stage)
    deadline_s = stage.pace.deadline_s(row.within_s, row.within_scans)
    back_limit_s = stage.pace.deadline_s(row.back_s, row.back_scans)
    times, sign = _perform(row, stage, patience * deadline_s, patience * back_limit_s)
    times = replace(times, due_ns=times.onset_ns + round(1e9 * deadline_s))
    heard = stage.witness.since(times.calm_ns)
    truth = stage.robot.truth(times.calm_ns)
    found = figures(heard, truth, times, restarts=row.restarts, stays=row.stays)
    detected_s = None if sign is None else 1e-9 * (sign.received_ns - times.onset_ns)
    recovered_s = None if times.back_ns is None else 1e-9 * (times.back_ns - times.end_ns)
    paused_s = stage.robot.surroundings.paused_s - before.paused_s
    if paused_s > _BUSY_S:
        stage.notes.append(f"busy computer: the world stood still for {paused_s:.1f} s")
    broken = [
        *stage.broken,
        *found.broken,
        *_late("said", detected_s, deadline_s if row.says is not None else None),
        *_late("back", recovered_s, back_limit_s),
        *_changed(row, stage, before, is_back=times.back_ns is not None),
    ]
    return Finding(
        number=row.number,
        fault=row.fault,
        sign=row.sign,
        detected_s=detected_s,
        deadline_s=deadline_s,
        states=states_of(heard, times.onset_ns),
        said="" if sign is None else _said(sign),
        recovered_s=recovered_s,
        worst_m=found.worst_m,
        unsaid_m=found.unsaid_m,
        beyond=found.beyond,
        gap_max_ms=found.gap_max_ms,
        gap_p99_ms=found.gap_p99_ms,
        broken=tuple(broken),
        notes=tuple(stage.notes),
        elsewhere=row.elsewhere,
    )


def _perform(
    row: Row, stage: Stage, sign_wait_s: float, back_wait_s: float
) -> tuple[Times, Heard | None]:
    """The drive itself; its instants, and the sign."""
    witness, calm_s = stage.witness, stage.pace.calm_s
    calm_ns = time.monotonic_ns()
    stage.rest(calm_s)
    begin_ns = time.monotonic_ns()
    sign = None
    with row.inject(stage):
        if row.says is not None:
            sign = witness.wait_for(row.says, begin_ns, sign_wait_s + 1.0)
        stage.rest(row.lasts_s - 1e-9 * (time.monotonic_ns() - begin_ns))
    end_ns = time.monotonic_ns()
    back = witness.wait_for(row.back, end_ns, back_wait_s + 1.0)
    if back is not None:
        stage.rest(calm_s)
    onset_ns = stage.onset_ns or begin_ns
    times = Times(
        calm_ns=calm_ns,
        onset_ns=onset_ns,
        end_ns=end_ns,
        back_ns=None if back is None else back.received_ns,
        due_ns=onset_ns,
    )
    return times, sign


def _changed(row: Row, stage: Stage, before: _Before, *, is_back: bool) -> list[str]:
    """What is otherwise than it was before the row, and should not be."""
    broken = []
    if stage.daemon.status is not None:
        broken.append(f"the daemon ended with status {stage.daemon.status}")
    elif is_back and not row.restarts:
        more = _settled(lambda: open_files(stage.daemon.pid), before.files) - before.files
        broken += [f"{more} more open files"] if more > 0 else []
    if not row.restarts and (refused := stage.witness.refused - before.refused):
        broken.append(f"{refused} payloads that are no messages")
    return broken


def _settled(count: Callable[[], int], wanted: int) -> int:
    """What is being closed just now is no leak."""
    for _ in range(20):
        if (now := count()) <= wanted:
            return now
        time.sleep(0.05)
    return count()


def _late(what: str, took_s: float | None, limit_s: float | None) -> list[str]:
    if limit_s is None:
        return []
    if took_s is None:
        return [f"never {what}"]
    return [] if took_s <= limit_s else [f"{what} after {took_s:.2f} s, wanted {limit_s:.2f} s"]


def _said(sign: Heard) -> str:
    message = sign.message
    if isinstance(message, Presence):
        return "gone"
    if isinstance(message, StatusMessage):
        parts = message.health().items()
        said = [f"{name}: {part.detail}" for name, part in parts if part.detail]
        said += [f"clock_steps {message.clock_steps}"] if message.clock_steps else []
        said += [message.fault] if message.fault else []
        return "; ".join(said)
    return message.fault or message.state.value
