"""From counts that wrap, repeat and restart, and from speeds, to angles that do neither.

Pure. Source: protocol fact sheet, section E.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a wheel can have done between two frames; beyond it, counting starts anew."""

    max_speed_radps: Annotated[float, Gt(0)] = 40.0
    """Fastest that a wheel can turn. A wheel of 0.15 m at 3 m/s: 20 rad/s; take twice that."""
    max_gap_s: Annotated[float, Gt(0)] = 0.5
    """Longest silence over which counts are trusted: an encoder may restart unseen in it."""
    max_speed_gap_s: Annotated[float, Gt(0)] = 0.1
    """Longest silence over which speeds are integrated: what happened in it nobody has seen."""
    stamp_jitter_s: Annotated[float, Ge(0)] = 0.03
    """By how much the time between two frames may be stamped too short (bursts in adapters)."""


class JointAngle:
    """The angle of one joint over time: its last two values and how often it began anew."""

    def __init__(self) -> None:
        self._before: tuple[int, float] | None = None
        self._latest: tuple[int, float] | None = None
        self._segment = 0
        self.raw: float | None = None
        """The newest value as the frame had it, for the technician."""

    @property
    def segment(self) -> int:
        """How often it had to start anew."""
        return self._segment

    @property
    def stamp_ns(self) -> int | None:
        """Of the newest value; None before the first."""
        return None if self._latest is None else self._latest[0]

    @property
    def interval_ns(self) -> int:
        """Between the last two values of one segment; 0 when there is but one."""
        if self._latest is None or self._before is None:
            return 0
        return self._latest[0] - self._before[0]

    def angle_at(self, stamp_ns: int) -> float | None:
        """The angle between the last two values of one segment in rad; None outside of them."""
        if self._latest is None:
            return None
        end_ns, end_rad = self._latest
        if stamp_ns == end_ns:
            return end_rad
        if self._before is None or not self._before[0] <= stamp_ns <= end_ns:
            return None
        start_ns, start_rad = self._before
        return start_rad + (end_rad - start_rad) * (stamp_ns - start_ns) / (end_ns - start_ns)

    def _elapsed_ns(self, stamp_ns: int) -> int | None:
        """Since the newest value; None when there was none."""
        return None if self._latest is None else stamp_ns - self._latest[0]

    def _go_on(self, stamp_ns: int, angle_rad: float, *, anew: bool) -> None:
        if anew:
            self._segment += self._latest is not None
            self._latest = None
        self._before, self._latest = self._latest, (stamp_ns, angle_rad)


class WheelCounter(JointAngle):
    """One wheel's angle since its first count.

    ``modulus`` is the number of counts after which the counter starts again from the same value:
    2 to its bits, or any other. ``rad_per_count`` is negative for a wheel mounted mirrored.
    """

    def __init__(self, modulus: int, rad_per_count: float, limits: Limits) -> None:
        super().__init__()
        self._modulus = modulus
        self._rad_per_count = rad_per_count
        self._limits = limits
        # Half a modulus is the most that a difference can mean: a faster wheel looks like another.
        alias_s = 0.5 * modulus * abs(rad_per_count) / limits.max_speed_radps
        self._max_gap_ns = round(1e9 * min(limits.max_gap_s, alias_s))
        self._count = 0
        self._total = 0

    def update(self, stamp_ns: int, count: int, *, restarted: bool = False) -> bool:
        """Take in one count; False when it is not newer than the last.

        ``restarted``: the sender is known to have started anew, whatever the count says.
        """
        elapsed_ns = self._elapsed_ns(stamp_ns)
        if elapsed_ns is not None and elapsed_ns <= 0:
            return False
        half = self._modulus // 2
        delta = (count - self._count + half) % self._modulus - half
        anew = restarted or elapsed_ns is None or not self._possible(delta, elapsed_ns)
        self._total += 0 if anew else delta
        self._count = self.raw = count
        self._go_on(stamp_ns, self._total * self._rad_per_count, anew=anew)
        return True

    def _possible(self, delta: int, elapsed_ns: int) -> bool:
        elapsed_s = 1e-9 * elapsed_ns + self._limits.stamp_jitter_s
        fastest_rad = self._limits.max_speed_radps * elapsed_s
        return elapsed_ns <= self._max_gap_ns and abs(delta * self._rad_per_count) <= fastest_rad


class SpeedIntegral(JointAngle):
    """One wheel's angle since its first speed: the trapezoid between each two of them.

    The last speed is never carried on: an angle ends where the last frame was.
    """

    def __init__(self, limits: Limits) -> None:
        super().__init__()
        self._max_gap_ns = round(1e9 * limits.max_speed_gap_s)
        self._speed_radps = 0.0
        self._total_rad = 0.0

    def update(self, stamp_ns: int, speed_radps: float, *, restarted: bool = False) -> bool:
        """As :meth:`WheelCounter.update`."""
        elapsed_ns = self._elapsed_ns(stamp_ns)
        if elapsed_ns is not None and elapsed_ns <= 0:
            return False
        anew = restarted or elapsed_ns is None or elapsed_ns > self._max_gap_ns
        if elapsed_ns is not None and not anew:
            self._total_rad += 0.5e-9 * elapsed_ns * (self._speed_radps + speed_radps)
        self._speed_radps = speed_radps
        self._go_on(stamp_ns, self._total_rad, anew=anew)
        return True


class SteerAngle(JointAngle):
    """A steering angle: absolute, so that nothing is summed; on the circle it goes the short way.

    After a gap it begins anew all the same: how the wheel was steered meanwhile is not known.
    """

    def __init__(self, limits: Limits) -> None:
        super().__init__()
        self._max_gap_ns = round(1e9 * limits.max_gap_s)
        self._angle_rad = 0.0

    def update(self, stamp_ns: int, angle_rad: float, *, restarted: bool = False) -> bool:
        """As :meth:`WheelCounter.update`."""
        elapsed_ns = self._elapsed_ns(stamp_ns)
        if elapsed_ns is not None and elapsed_ns <= 0:
            return False
        anew = restarted or elapsed_ns is None or elapsed_ns > self._max_gap_ns
        start_rad = 0.0 if anew else self._angle_rad
        self._angle_rad = start_rad + math.remainder(angle_rad - start_rad, 2.0 * math.pi)
        self._go_on(stamp_ns, self._angle_rad, anew=anew)
        return True


def rad_per_count(counts_per_revolution: int, gear_ratio: float, sign: int) -> float:
    """Wheel rotation in rad that one count stands for."""
    return sign * 2.0 * math.pi / (counts_per_revolution * gear_ratio)
