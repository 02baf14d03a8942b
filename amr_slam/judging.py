"""Were the published poses right, in time, and honest about themselves?

The judge of a run whose truth is known. *Wrong without saying so*: a pose that is offered for
driving (:data:`amr_slam.simulation.DRIVABLE`) and is further from the truth than
:data:`SILENT_FACTOR` times the error that it reports, and than a bar below which nobody is harmed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.evaluation import ErrorSummary, error95_coverage, poses_at
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.recording import Trajectory
from amr_slam.samples import State
from amr_slam.simulation import DRIVABLE

SILENT_FACTOR: Final = 3.0
"""Six standard deviations: no bad luck any more."""
SILENT_POSITION_M: Final = 0.15
"""What the tour's planner leaves beside the hull."""
SILENT_HEADING_DEG: Final = 5.0
"""After 1.7 m it is 0.15 m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportedPose:
    """One pose as a consumer received it."""

    seq: int
    stamp_ns: int
    """The instant for which it is true, on the truth's clock."""
    received_ns: int
    """When it came in, on the same clock."""
    map_from_base: Pose2
    error95_m: float
    heading95_rad: float
    """The heading error not exceeded in 95 % of the cases."""
    state: State


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What the poses of a run were worth; errors are those of the judged ones."""

    poses: int
    """Received."""
    judged: int
    """Offered for driving, at a stamp at which the truth is known."""
    lost: int
    """Sent, by their numbers, but not received."""
    position_m: ErrorSummary | None
    """None without a judged pose, as the next two."""
    heading_deg: ErrorSummary | None
    error95_coverage: float | None
    """Share of position errors within the reported one; honest: 0.95 or a little more."""
    wrong_silently: int
    """Judged poses that were wrong without saying so."""
    rate_hz: float
    """By the stamps of the first and the last; 0 of fewer than two."""
    rate_deviation: float
    """Share by which the rate differs from the nominal one."""
    latency_median_ms: float
    """From the stamp to the reception."""
    latency_p99_ms: float
    states: dict[str, float]
    """Share of the poses in each state."""

    @property
    def is_trustworthy(self) -> bool:
        """There were poses to drive by, and none was wrong without saying so."""
        return self.judged > 0 and self.wrong_silently == 0

    def text(self) -> str:
        """For people: one line a question."""
        states = ", ".join(f"{state} {share:.1%}" for state, share in self.states.items())
        lines = [
            f"poses        {self.poses}, {self.lost} lost on the way",
            f"rate         {self.rate_hz:.2f} Hz ({self.rate_deviation:+.2%} of the nominal one)",
            f"states       {states}",
            f"latency      median {self.latency_median_ms:.1f}, p99 {self.latency_p99_ms:.1f} ms",
        ]
        if self.position_m is not None and self.heading_deg is not None:
            for name, error, scale, unit in (
                ("position", self.position_m, 100.0, "cm"),
                ("heading", self.heading_deg, 1.0, "deg"),
            ):
                rms, p95, most = (scale * size for size in (error.rms, error.p95, error.max))
                lines.append(f"{name:9}    rms {rms:.2f}, p95 {p95:.2f}, max {most:.2f} {unit}")
            lines.append(
                f"error95_m    holds for {self.error95_coverage:.1%} of {self.judged} poses"
            )
        lines.append(f"wrong without saying so: {self.wrong_silently} of {self.judged} poses")
        return "\n".join(lines)


def judge(reports: Sequence[ReportedPose], truth: Trajectory, nominal_hz: float = 50.0) -> Verdict:
    """Compare received poses with the truth (``map_from_base``) at their own stamps.

    ``nominal_hz``: the rate at which poses should come, that of the wheels.

    Raises ValueError when there is no pose.
    """
    if not reports:
        raise ValueError("no poses to judge")
    stamps_ns = np.array([report.stamp_ns for report in reports], dtype=np.int64)
    latency_ms = 1e-6 * np.array([report.received_ns - report.stamp_ns for report in reports])
    where, known = poses_at(truth, stamps_ns)
    offered = np.array([report.state in DRIVABLE for report in reports])
    judged = np.flatnonzero(known & offered)
    offsets = np.array([report.map_from_base.as_array() for report in reports]) - where
    position_m = np.hypot(offsets[judged, 0], offsets[judged, 1])
    heading_deg = np.degrees(np.abs(wrap_angle(offsets[judged, 2])))
    error95_m = np.array([report.error95_m for report in reports])[judged]
    heading95_deg = np.degrees([report.heading95_rad for report in reports])[judged]
    wrong = _is_silent(position_m, error95_m, SILENT_POSITION_M)
    wrong |= _is_silent(heading_deg, heading95_deg, SILENT_HEADING_DEG)
    numbers = [report.seq for report in reports]
    states = Counter(report.state.value for report in reports)
    span_s = 1e-9 * float(stamps_ns.max() - stamps_ns.min())
    rate_hz = (len(reports) - 1) / span_s if span_s > 0.0 else 0.0
    return Verdict(
        poses=len(reports),
        judged=len(judged),
        lost=max(numbers) - min(numbers) + 1 - len(set(numbers)),
        position_m=ErrorSummary.of(position_m) if len(judged) else None,
        heading_deg=ErrorSummary.of(heading_deg) if len(judged) else None,
        error95_coverage=error95_coverage(position_m, error95_m) if len(judged) else None,
        wrong_silently=int(wrong.sum()),
        rate_hz=rate_hz,
        rate_deviation=rate_hz / nominal_hz - 1.0,
        latency_median_ms=float(np.median(latency_ms)),
        latency_p99_ms=float(np.percentile(latency_ms, 99.0)),
        states={state: count / len(reports) for state, count in states.items()},
    )


def _is_silent(errors: Array, reported: Array, bar: float) -> NDArray[np.bool_]:
    """(n,) beyond what was reported and beyond the bar; what is not finite is wrong, too."""
    silent: NDArray[np.bool_] = ~(errors <= np.maximum(SILENT_FACTOR * reported, bar))
    return silent
