"""From encoder counts that wrap, repeat and restart to wheel angles that do neither.

Pure. Source: protocol fact sheet, section E.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt

from amr_slam.samples import WheelSample


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a wheel can have done between two frames; beyond it, counting starts anew."""

    max_speed_radps: Annotated[float, Gt(0)] = 40.0
    """Fastest that a wheel can turn. A wheel of 0.15 m at 3 m/s: 20 rad/s; take twice that."""
    max_gap_s: Annotated[float, Gt(0)] = 0.5
    """Longest silence over which counts are trusted: an encoder may restart unseen in it."""
    stamp_jitter_s: Annotated[float, Ge(0)] = 0.03
    """By how much the time between two frames may be stamped too short (bursts in adapters)."""


class WheelCounter:
    """One wheel's angle, in rad, since its first count.

    ``modulus`` is the number of counts after which the counter starts again from the same value:
    2 to its bits, or any other. ``rad_per_count`` is negative for a wheel mounted mirrored.
    """

    def __init__(self, modulus: int, rad_per_count: float, limits: Limits) -> None:
        self._modulus = modulus
        self._rad_per_count = rad_per_count
        self._limits = limits
        # Half a modulus is the most that a difference can mean: a faster wheel looks like another.
        alias_s = 0.5 * modulus * abs(rad_per_count) / limits.max_speed_radps
        self._max_gap_ns = round(1e9 * min(limits.max_gap_s, alias_s))
        self._count = 0
        self._total = 0
        self._before: tuple[int, float] | None = None
        self._latest: tuple[int, float] | None = None
        self._segment = 0

    @property
    def segment(self) -> int:
        """How often counting had to start anew."""
        return self._segment

    @property
    def stamp_ns(self) -> int | None:
        """Of the newest count; None before the first."""
        return None if self._latest is None else self._latest[0]

    def update(self, stamp_ns: int, count: int, *, restarted: bool = False) -> bool:
        """Take in one count; False when it is not newer than the last.

        ``restarted``: the sender is known to have started anew, whatever the count says.
        """
        if self._latest is not None:
            last_ns = self._latest[0]
            if stamp_ns <= last_ns:
                return False
            half = self._modulus // 2
            delta = (count - self._count + half) % self._modulus - half
            if restarted or not self._possible(delta, stamp_ns - last_ns):
                self._segment += 1
                self._latest = None
            else:
                self._total += delta
        self._before, self._count = self._latest, count
        self._latest = stamp_ns, self._total * self._rad_per_count
        return True

    def angle_at(self, stamp_ns: int) -> float | None:
        """The angle between the last two counts of one segment; None outside of them."""
        if self._latest is None:
            return None
        end_ns, end_rad = self._latest
        if stamp_ns == end_ns:
            return end_rad
        if self._before is None or not self._before[0] <= stamp_ns <= end_ns:
            return None
        start_ns, start_rad = self._before
        return start_rad + (end_rad - start_rad) * (stamp_ns - start_ns) / (end_ns - start_ns)

    def _possible(self, delta: int, elapsed_ns: int) -> bool:
        elapsed_s = 1e-9 * elapsed_ns + self._limits.stamp_jitter_s
        fastest_rad = self._limits.max_speed_radps * elapsed_s
        return elapsed_ns <= self._max_gap_ns and abs(delta * self._rad_per_count) <= fastest_rad


class WheelPair:
    """Both wheels at one instant, also when their counts come at two."""

    def __init__(self, left: WheelCounter, right: WheelCounter) -> None:
        self._left = left
        self._right = right
        self._newest_ns: int | None = None

    def sample(self) -> WheelSample | None:
        """A sample once both wheels have counts newer than the last sample; else None.

        Its stamp is that of the wheel heard first; the other wheel's angle is interpolated to it.
        """
        left_ns, right_ns = self._left.stamp_ns, self._right.stamp_ns
        if left_ns is None or right_ns is None:
            return None
        stamp_ns = min(left_ns, right_ns)
        if self._newest_ns is not None and stamp_ns <= self._newest_ns:
            return None
        left_rad, right_rad = self._left.angle_at(stamp_ns), self._right.angle_at(stamp_ns)
        if left_rad is None or right_rad is None:
            return None
        self._newest_ns = stamp_ns
        return WheelSample(
            stamp_ns=stamp_ns,
            left_rad=left_rad,
            right_rad=right_rad,
            segment=self._left.segment + self._right.segment,
        )


def rad_per_count(counts_per_revolution: int, gear_ratio: float, sign: int) -> float:
    """Wheel rotation in rad that one count stands for."""
    return sign * 2.0 * math.pi / (counts_per_revolution * gear_ratio)
