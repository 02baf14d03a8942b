"""What is told of wheels that the scans have caught lying: which wheel, by how much, when."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

from amr_slam.fusion import Slip
from amr_slam.odometry import DifferentialDrive, Odometry
from amr_slam.samples import Motion

KEPT: Final = 5
# One wheel is to blame when the other's error is smaller than this share of its own.
_BLAMELESS: Final = 0.35
# Beyond this turn the two wheels' ways no longer follow from where the robot ended up.
_STRAIGHT_RAD: Final = 0.7
# A wheel that moved less than this while the robot did not stand was stuck, or its counter was.
_STUCK_M: Final = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelEvent:
    """One disagreement."""

    slip: Slip
    text: str
    """For people."""


class WheelEvents:
    """The last disagreements of wheels and scans."""

    def __init__(self, odometry: Odometry) -> None:
        self._track_m = odometry.track_m if isinstance(odometry, DifferentialDrive) else None
        self._events: deque[WheelEvent] = deque(maxlen=KEPT)

    @property
    def newest(self) -> tuple[WheelEvent, ...]:
        """At most :data:`KEPT`, the newest last."""
        return tuple(self._events)

    def note(self, slip: Slip, reported: Motion | None) -> None:
        """``reported``: what the wheels said of the way in question. One event a fix."""
        if self._events and self._events[-1].slip.stamp_ns == slip.stamp_ns:
            return
        self._events.append(WheelEvent(slip=slip, text=self._text(slip, reported)))

    def note_leap(self, slip: Slip, fresh_s: float) -> None:
        """A leap in speed, once while it is fresh: it goes on for several samples."""
        if not self._events or slip.stamp_ns - self._events[-1].slip.stamp_ns > 1e9 * fresh_s:
            self.note(slip, None)

    def note_standing(self, wheel: str, since_ns: int, stamp_ns: int) -> None:
        """A wheel whose counts stand, told by the wheels alone."""
        slip = Slip(stamp_ns=stamp_ns, since_ns=since_ns, forward_m=0.0, left_m=0.0, turn_rad=0.0)
        text = f"{wheel} wheel stuck: its counts stand, the other wheel's go on"
        self._events.append(WheelEvent(slip=slip, text=text))

    def fault(self, now_ns: int, fresh_s: float) -> str | None:
        """The newest event while it is fresh."""
        if not self._events or now_ns - self._events[-1].slip.stamp_ns > 1e9 * fresh_s:
            return None
        return self._events[-1].text

    def _text(self, slip: Slip, reported: Motion | None) -> str:
        span_s = 1e-9 * (slip.stamp_ns - slip.since_ns)
        if slip.forward_m == slip.left_m == slip.turn_rad == 0.0:
            return f"wheels slip: their speed leapt within {span_s:.1f} s"
        way_m = math.copysign(math.hypot(slip.forward_m, slip.left_m), slip.forward_m)
        size = f"{way_m:+.2f} m, {math.degrees(slip.turn_rad):+.0f} deg within {span_s:.1f} s"
        return f"{self._blamed(slip, reported)}: the robot went {size} beside what they said"

    def _blamed(self, slip: Slip, reported: Motion | None) -> str:
        """Where the drive is differential, errors ahead and in turn tell the wheel."""
        if self._track_m is None or reported is None or abs(slip.turn_rad) > _STRAIGHT_RAD:
            return "wheels slip"
        half_m = 0.5 * self._track_m
        ahead_m, _, turn_rad = reported.delta.log()
        errors_m = {
            "left": slip.forward_m - half_m * slip.turn_rad,
            "right": slip.forward_m + half_m * slip.turn_rad,
        }
        ways_m = {"left": ahead_m - half_m * turn_rad, "right": ahead_m + half_m * turn_rad}
        worst = max(errors_m, key=lambda name: abs(errors_m[name]))
        other = "right" if worst == "left" else "left"
        if abs(errors_m[other]) > _BLAMELESS * abs(errors_m[worst]):
            return "wheels slip"
        stuck = abs(ways_m[worst]) < _STUCK_M and abs(errors_m[worst]) > abs(ways_m[worst])
        return f"{worst} wheel stuck" if stuck else f"{worst} wheel slips"
