"""When poses are due, and what UTC it is: the only clocks besides the monotonic one."""

from __future__ import annotations

import logging
import time
from typing import Final

_log = logging.getLogger(__name__)

_MEASURE_PERIOD_NS: Final = 20_000_000
"""A pose after the clock was set bears the new time."""
_STEP_NS: Final = 50_000_000
"""The wall clock does not run away by this much meanwhile: somebody has set it."""
_DISTURBED_NS: Final = 1_000_000
"""A reading of both clocks that took longer is none: the computer was busy."""
_FOLLOW: Final = 0.1
"""Share of a wheel sample's deviation by which the schedule follows the wheels' own clock."""


class PoseSchedule:
    """A pose for each wheel sample, at most one a period, and on time without wheels too.

    The due times are counted, not measured anew from each pose, so that the rate does not drift.
    """

    def __init__(self, rate_hz: float, now_ns: int) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._due_ns = now_ns

    def takes(self, now_ns: int, *, wheels_came: bool) -> bool:
        """Whether a pose is to be published at ``now_ns``; if so, the next one is scheduled."""
        half_ns = self._period_ns // 2
        late_ns = now_ns - self._due_ns
        if late_ns < (-half_ns if wheels_came else half_ns):
            return False
        if late_ns > self._period_ns:
            self._due_ns = now_ns  # after a stall, what was missed is not made up for
        elif wheels_came:
            self._due_ns += round(_FOLLOW * late_ns)
        self._due_ns += self._period_ns
        return True

    def wait_s(self, now_ns: int) -> float:
        """How long to wait for a wheel sample before a pose goes without one."""
        return 1e-9 * max(0, self._due_ns + self._period_ns // 2 - now_ns)


class WallClock:
    """UTC from the monotonic clock, by an offset that is measured for each pose."""

    def __init__(self) -> None:
        self.utc_from_monotonic_ns, _ = _measured_ns()
        self._measured_ns = time.monotonic_ns()
        self.steps = 0
        """How often UTC was set by more than 50 ms since the start."""

    def follow(self, now_ns: int) -> None:
        """Measure anew when a pose's period has passed. Estimates never see the step, stamps
        do."""
        if now_ns - self._measured_ns < _MEASURE_PERIOD_NS:
            return
        offset_ns, doubt_ns = _measured_ns()
        if doubt_ns > _DISTURBED_NS:
            return  # and look again next time: stamps must not go back by it
        self._measured_ns = now_ns
        step_ns = offset_ns - self.utc_from_monotonic_ns
        if abs(step_ns) > _STEP_NS:
            self.steps += 1
            _log.warning("the clock of this computer was set by %+.3f s", 1e-9 * step_ns)
        self.utc_from_monotonic_ns = offset_ns


def _measured_ns() -> tuple[int, int]:
    """UTC minus monotonic, and how long it took to read: the least disturbed of three."""
    best_ns, offset_ns = 1 << 62, 0
    for _ in range(3):
        before_ns = time.monotonic_ns()
        wall_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        if after_ns - before_ns < best_ns:
            best_ns, offset_ns = after_ns - before_ns, wall_ns - (before_ns + after_ns) // 2
    return offset_ns, best_ns
