"""What a robot published, held against the truth and against what must never happen.

The judge is pure: messages in, findings out, so that it can itself be tested with lies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from amr_slam.evaluation import poses_at
from amr_slam.geometry import Array
from amr_slam.judging import SILENT_FACTOR, SILENT_POSITION_M, ReportedPose, judge
from amr_slam.recording import Trajectory
from amr_slam.states import State
from amr_slam.studies.faults.witness import CLOCK_STEP_S, Heard
from amr_slam.wire import PoseMessage, StatusMessage

BLOCKED_MS: Final = 500.0
"""A longer pause is no busy computer any more: somebody waited. The table tells all pauses."""
GROWTH_MB: Final = 30.0
"""Memory that one row may take: half a minute of the recorder's ring, and a map read anew."""
_OLD_S: Final = 0.1
"""Further than this from the last wheel sample nothing is extrapolated: the stamp stands still."""
_RESOLUTION_S: Final = 1e-6
"""Of UTC in a double, and of the measured offset between the clocks."""
WORSE_M: Final = 0.02
WORSE_FACTOR: Final = 2.0
"""After the fault, poses are as good as before: the median error, by no more than these."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """The instants of a row, ``time.monotonic_ns()``."""

    calm_ns: int
    """From here on the robot was observed,"""
    onset_ns: int
    """the fault lasted from here"""
    end_ns: int
    """to here,"""
    back_ns: int | None
    """and from here on the robot was well again."""
    due_ns: int
    """Until here the sign was to come; errors before it nobody could know of."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Of one row. None where no pose was claimed localized at all."""

    worst_m: float | None
    unsaid_m: float | None
    beyond: float | None
    gap_max_ms: float | None
    gap_p99_ms: float | None
    broken: tuple[str, ...] = field(default_factory=tuple)


def figures(
    heard: Sequence[Heard],
    truth: Trajectory,
    times: Times,
    *,
    restarts: bool = False,
    stays: frozenset[State] | None = None,
) -> Figures:
    """``heard``: of a row, in order. ``truth``: in the frame of the poses.
    ``restarts``: the daemon was ended in it, so that there are no poses for a while."""
    poses = [one.report for one in heard if one.report is not None]
    claimed = [report for report in poses if report.state is State.LOCALIZED]
    errors_m = _errors_m(claimed, truth)
    bounds_m = np.array([report.error95_m for report in claimed])
    late = np.array([report.received_ns > times.due_ns for report in claimed], dtype=np.bool_)
    early = np.array([report.received_ns < times.onset_ns for report in claimed], dtype=np.bool_)
    known = np.isfinite(errors_m)
    gaps_ms = 1e-6 * np.diff([report.received_ns for report in poses])
    broken = [
        *_lies(claimed, truth, times),
        *_stamps(heard, restarts=restarts),
        *_blocked(gaps_ms, restarts=restarts),
        *_left(poses, times, stays),
        *_grown(heard, restarts=restarts),
        *_worse(claimed, errors_m, times),
    ]
    return Figures(
        worst_m=_most(errors_m[known]),
        unsaid_m=_most(errors_m[known & (late | early)]),
        beyond=float(np.mean(errors_m[known] > bounds_m[known])) if known.any() else None,
        gap_max_ms=_most(gaps_ms),
        gap_p99_ms=float(np.percentile(gaps_ms, 99.0)) if len(gaps_ms) else None,
        broken=tuple(broken),
    )


def states_of(heard: Sequence[Heard], since_ns: int) -> str:
    """The states claimed one after another."""
    seen: list[str] = []
    for one in heard:
        if one.report is None or one.received_ns < since_ns:
            continue
        if not seen or seen[-1] != one.report.state.value:
            seen.append(one.report.state.value)
    return " → ".join(seen) or "none"


def _errors_m(claimed: Sequence[ReportedPose], truth: Trajectory) -> Array:
    """(n,) NaN where the truth is not known."""
    if not claimed:
        return np.zeros(0)
    where, known = poses_at(truth, np.array([one.stamp_ns for one in claimed], dtype=np.int64))
    positions = np.array([one.map_from_base.translation for one in claimed])
    errors: Array = np.hypot(*(positions - where[:, :2]).T)
    # What is not finite is infinitely wrong, not unknown.
    return np.where(known, np.where(np.isnan(errors), np.inf, errors), np.nan)


def _most(values: Array) -> float | None:
    return float(values.max()) if len(values) else None


def _lies(claimed: Sequence[ReportedPose], truth: Trajectory, times: Times) -> list[str]:
    """Poses that are wrong without saying so; between onset and deadline nobody can know."""
    judged = [
        one for one in claimed if one.received_ns > times.due_ns or one.stamp_ns < times.onset_ns
    ]
    if not judged:
        return []
    wrong = judge(judged, truth).wrong_silently
    said = f"by {SILENT_FACTOR:g} x error95_m and {SILENT_POSITION_M:g} m"
    return [f"wrong without saying so: {wrong} poses, {said}"] if wrong else []


def _stamps(heard: Sequence[Heard], *, restarts: bool) -> list[str]:
    """Each pose is of a later instant than the last one, or says how old it is."""
    broken = []
    back = repeated = 0
    before: PoseMessage | None = None
    for one in heard:
        pose = one.message
        if not isinstance(pose, PoseMessage):
            continue
        if before is not None and pose.seq > before.seq:
            step_s = math.remainder(pose.stamp - before.stamp, CLOCK_STEP_S)
            is_told = pose.age_s > _OLD_S or pose.state is not State.LOCALIZED
            back += step_s < -_RESOLUTION_S
            repeated += abs(step_s) <= _RESOLUTION_S and not is_told
        elif before is not None and not restarts:
            broken.append("pose numbers began anew")
        before = pose
    if back:
        broken.append(f"{back} poses stamped before the one before them")
    if repeated:
        broken.append(f"{repeated} poses repeated without saying so")
    return broken


def _blocked(gaps_ms: Array, *, restarts: bool) -> list[str]:
    longest_ms = _most(gaps_ms)
    if restarts or longest_ms is None or longest_ms <= BLOCKED_MS:
        return []
    return [f"no pose for {1e-3 * longest_ms:.2f} s"]


def _left(poses: Sequence[ReportedPose], times: Times, stays: frozenset[State] | None) -> list[str]:
    if stays is None:
        return []
    until_ns = times.end_ns if times.back_ns is None else times.back_ns
    left = {
        report.state.value
        for report in poses
        if times.onset_ns <= report.received_ns <= until_ns and report.state not in stays
    }
    return [f"did not go on, but was {', '.join(sorted(left))}"] if left else []


def _grown(heard: Sequence[Heard], *, restarts: bool) -> list[str]:
    used = [one.message.memory_mb for one in heard if isinstance(one.message, StatusMessage)]
    if restarts or len(used) < 2 or used[-1] - used[0] <= GROWTH_MB:
        return []
    return [f"grown by {used[-1] - used[0]:.0f} MB"]


def _worse(claimed: Sequence[ReportedPose], errors_m: Array, times: Times) -> list[str]:
    if times.back_ns is None:
        return []
    known = np.isfinite(errors_m)
    stamps = np.array([one.received_ns for one in claimed], dtype=np.int64)
    before = errors_m[known & (stamps < times.onset_ns)]
    after = errors_m[known & (stamps > times.back_ns)]
    if not len(before) or not len(after):
        return []
    was_m, is_m = float(np.median(before)), float(np.median(after))
    if is_m <= max(WORSE_FACTOR * was_m, was_m + WORSE_M) and math.isfinite(is_m):
        return []
    return [f"{is_m:.3f} m off afterwards, {was_m:.3f} m before"]
