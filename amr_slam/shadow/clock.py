"""By how much a camera system's stamps are off, from how its poses run ahead or behind in turns.

A heading that is seen late by d differs by the turn rate times d, whatever the frames: the slope
of one over the other is d. Without headings the same is told by the way ahead, in a map that lies
in the cameras' frame.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.geometry import Array, wrap_angle

_ARRIVALS: Final = 50
_SAME_CLOCK_S: Final = 2.0
"""Messages that arrive farther from their stamps than this come from a clock of another time."""
_WINDOW: Final = 1500
_LEAST: Final = 150
_EVERY: Final = 50
_SHARED: Final = 10.0
"""Neighbouring poses share their errors: so many count as one."""
_SIGMA_S: Final = 0.02
_MOST_S: Final = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """This added to the camera's stamps is the robot's time."""

    clock_s: float
    sigma_s: float | None
    """None where it is not known better than by arrival."""


class ClockDifference:
    """Estimated while driving, or as configured. Not for more than one thread."""

    def __init__(self, clock_s: float | None) -> None:
        self._given_s = clock_s
        self._base_s = clock_s or 0.0
        self._late_s, self._sigma_s = 0.0, None if clock_s is None else 0.0
        self._arrivals: deque[float] = deque(maxlen=_ARRIVALS)
        self._rates: deque[tuple[float, float]] = deque(maxlen=_WINDOW)
        self._since = 0

    @property
    def base_s(self) -> float:
        """Without the estimate: what :meth:`note` wants its differences to be made with."""
        return self._base_s

    @property
    def known(self) -> Difference:
        return Difference(clock_s=self._base_s + self._late_s, sigma_s=self._sigma_s)

    def arrived(self, stamp_s: float, received_s: float) -> None:
        """A message came in. Clocks that have nothing to do with each other are brought together
        by this."""
        if self._given_s is not None:
            return
        self._arrivals.append(received_s - stamp_s)
        middle_s = float(np.median(self._arrivals)) if len(self._arrivals) % 10 == 1 else None
        if middle_s is None:
            return
        base_s = 0.0 if abs(middle_s) <= _SAME_CLOCK_S else middle_s
        if abs(base_s - self._base_s) > _SAME_CLOCK_S:
            self._base_s, self._late_s, self._sigma_s = base_s, 0.0, None
            self._rates.clear()

    def note(self, rate: float, difference: float) -> None:
        """A difference (camera less robot; rad or m) at a rate (rad/s or m/s), both at the
        camera's stamp + :attr:`base_s`."""
        if self._given_s is not None:
            return
        self._rates.append((rate, difference))
        self._since += 1
        if len(self._rates) >= _LEAST and self._since >= _EVERY:
            self._since = 0
            self._late_s, self._sigma_s = _slope(np.array(self._rates))


def _slope(noted: Array) -> tuple[float, float | None]:
    """Slope and its standard deviation; (0, None) where it is not told."""
    rate, difference = noted[:, 0], noted[:, 1]
    middle = float(np.angle(np.mean(np.exp(1j * difference))))
    off = wrap_angle(difference - middle)
    kept = np.abs(off - np.median(off)) < 0.5  # markers that were taken for others
    for _ in range(3):
        if kept.sum() < _LEAST // 2:
            return 0.0, None
        table = np.column_stack([np.ones(int(kept.sum())), rate[kept]])
        (start, slope), *_ = np.linalg.lstsq(table, off[kept], rcond=None)
        left = off - start - slope * rate
        spread = 1.4826 * float(np.median(np.abs(left[kept]))) + 1e-6
        kept = np.abs(left) < 4.0 * spread
    varied = float(np.std(rate[kept]))
    sigma_s = spread / max(varied, 1e-9) * math.sqrt(_SHARED / max(int(kept.sum()), 1))
    if sigma_s > _SIGMA_S or abs(slope) > _MOST_S:
        return 0.0, None
    return float(slope), sigma_s
