"""What there is to say of a robot, in short, and in which order robots are shown."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from amr_slam.client import RobotView
from amr_slam.samples import State
from amr_slam.wire import UNKNOWN, PoseMessage

Sort = Literal["name", "state", "error", "age"]
"""By name, or what needs a look first."""

COLUMNS: Final = (
    "state",
    "x m",
    "y m",
    "theta deg",
    "error95 m",
    "age s",
    "fix s",
    "rate Hz",
    "map",
    "epoch",
    "health",
)
_STALE_S: Final = 0.5  # 25 poses at 50 Hz: older is not a pose to drive by
_RATE_S: Final = 1.0
_NONE: Final = "-"
ABSENT, SILENT, STALE = "absent", "silent", "stale"
"""Not there; there, but without a pose so far; there, and its poses have stopped."""
_WORST_FIRST: Final = (
    ABSENT,
    STALE,
    State.LOST,
    State.AMBIGUOUS,
    SILENT,
    State.STARTING,
    State.ODOMETRY_ONLY,
    State.MAPPING,
    State.LOCALIZED,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One robot, as it is shown."""

    view: RobotView
    state: str
    """Of the pose, where that is fresh; else why there is none to drive by."""
    age_s: float
    """Since the wheel sample in the newest pose; inf before the first pose."""
    rate_hz: float | None
    """Poses that come in; None before they were counted for a second."""

    def cells(self) -> tuple[str, ...]:
        """Its name, and the text of each of :data:`COLUMNS`."""
        name, pose, rate_hz = printable(self.view.robot), self.view.pose, self.rate_hz
        rate = _NONE if rate_hz is None else f"{rate_hz:.1f}"
        if pose is None:
            return (name, self.state, *[_NONE] * 6, rate, _NONE, _NONE, _health(self.view))
        return (
            name,
            self.state,
            f"{pose.x:.3f}",
            f"{pose.y:.3f}",
            f"{math.degrees(pose.theta):.2f}",
            _known(pose.error95_m, 3),
            f"{self.age_s:.2f}",
            _known(pose.since_fix_s, 1),
            rate,
            _map(self.view, pose),
            str(pose.epoch),
            _health(self.view),
        )

    def values(self) -> dict[str, Any]:
        """All that is known, as JSON has it."""
        pose, status = self.view.pose, self.view.status
        return {
            "robot": self.view.robot,
            "state": self.state,
            "alive": self.view.alive,
            "age_s": self.age_s if math.isfinite(self.age_s) else None,
            "rate_hz": self.rate_hz,
            "lost": self.view.lost,
            "restarts": self.view.restarts,
            "refused": self.view.refused,
            "pose": None if pose is None else pose.model_dump(mode="json"),
            "status": None if status is None else status.model_dump(mode="json"),
        }


class Rates:
    """Counts what comes in."""

    def __init__(self) -> None:
        self._marks: dict[str, tuple[float, int]] = {}
        self._rates_hz: dict[str, float] = {}

    def rows(self, views: Mapping[str, RobotView], sort: Sort, now_s: float) -> list[Row]:
        """The robots as they are to be shown now; ``now_s``: ``time.monotonic()``."""
        return sorted((self._row(view, now_s) for view in views.values()), key=_KEYS[sort])

    def _row(self, view: RobotView, now_s: float) -> Row:
        since_s, poses = self._marks.setdefault(view.robot, (now_s, view.poses))
        if now_s - since_s >= _RATE_S:
            self._rates_hz[view.robot] = (view.poses - poses) / (now_s - since_s)
            self._marks[view.robot] = now_s, view.poses
        age_s = math.inf if view.pose is None else view.pose.age_s + view.pose_age_s()
        return Row(
            view=view, state=_state(view), age_s=age_s, rate_hz=self._rates_hz.get(view.robot)
        )


def row_of(view: RobotView) -> Row:
    """The row of one look, without a rate."""
    return Rates().rows({view.robot: view}, "name", time.monotonic())[0]


def _state(view: RobotView) -> str:
    if not view.alive:
        return ABSENT
    if view.pose is None:
        return SILENT
    return STALE if view.pose_age_s() > _STALE_S else str(view.pose.state)


def _error(row: Row) -> float:
    return math.inf if row.view.pose is None else row.view.pose.error95_m


_KEYS: Final[dict[Sort, Any]] = {
    "name": lambda row: row.view.robot,
    "state": lambda row: (_WORST_FIRST.index(row.state), row.view.robot),
    "error": lambda row: (-_error(row), row.view.robot),
    "age": lambda row: (-row.age_s, row.view.robot),
}


def _known(value: float, digits: int) -> str:
    return "unknown" if value >= UNKNOWN else f"{value:.{digits}f}"


def _map(view: RobotView, pose: PoseMessage) -> str:
    """Its name, where the status speaks of the pose's map, else the beginning of its UUID."""
    if pose.map is None:
        return _NONE
    named = view.status.map if view.status is not None else None
    return printable(named.name if named is not None and named.id == pose.map else pose.map[:8])


def _health(view: RobotView) -> str:
    """What is wrong, or OK."""
    said = [view.pose.fault] if view.pose and view.pose.fault else []
    if view.status is not None:
        said += [
            f"{one.odds:.0%} at ({one.x:.2f}, {one.y:.2f}, {math.degrees(one.theta):.0f} deg)"
            for one in view.status.candidates
        ]
        said += [
            f"{name} {part.link}" + (f" ({part.detail})" if part.detail else "")
            for name, part in view.status.health().items()
            if part.link != "OK" or part.detail
        ]
        said += [view.status.advice] if view.status.advice else []
    if view.refused:
        said.append(f"{view.refused} bad messages")
    if view.lost:
        said.append(f"{view.lost} poses lost on the way")
    healthy = "OK" if view.status is not None else _NONE
    return printable("; ".join(said)) or healthy


def printable(text: str) -> str:
    """Without the control characters by which a name could steer the terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)
