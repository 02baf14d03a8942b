"""When bytes arrived, and from that when a scan was measured. Pure.

A telegram can arrive late (USB adapters hold bytes back, threads wait) but never early. The
scanner's mirror turns evenly and its scan number counts the turns, so that all arrivals lie on or
above a line over the scan number; the lowest ones tell where the line is (fact sheet, A.7).
"""

from __future__ import annotations

from collections import deque

import numpy as np

from amr_slam.geometry import Array

_WINDOW = 100
"""Arrivals remembered: 4 s of an S300, in which a scanner's clock drifts by far below 1 ms."""
_ENOUGH = 8
"""Arrivals from which on the later half is left out of the slope."""
_MAX_STEP = 1000
_NUMBERS = 2**32
_MAX_DOUBTFUL = 20
"""More old telegrams than this cannot wait in a serial port (16 were counted)."""


class Arrivals:
    """When each byte of a stream arrived; memory of the pieces that may still matter."""

    def __init__(self) -> None:
        self._pieces: deque[tuple[int, int]] = deque()

    def add(self, position: int, stamp_ns: int) -> None:
        """The bytes from ``position`` of the stream on arrived at ``stamp_ns``."""
        self._pieces.append((position, stamp_ns))

    def at(self, offset: int) -> int:
        """When the byte at ``offset`` of the stream arrived; forgets what came before it.

        One piece must have been added.
        """
        while len(self._pieces) > 1 and self._pieces[1][0] <= offset:
            self._pieces.popleft()
        return self._pieces[0][1]


class ArrivalClock:
    """Arrival times of numbered telegrams, freed from the delays of the line.

    ``latency_limit_ns`` is the longest delay that an adapter and a scheduler can be blamed for. A
    telegram that is later waited somewhere and is old, or the numbering has changed.
    """

    def __init__(self, latency_limit_ns: int) -> None:
        self._limit_ns = latency_limit_ns
        self._arrivals: deque[tuple[int, int]] = deque(maxlen=_WINDOW)
        self._doubtful: tuple[int, int] | None = None
        self._doubts = 0
        self._period_ns: float | None = None

    @property
    def period_s(self) -> float | None:
        """The measured time between scan numbers; None before the second arrival. Any thread."""
        return None if self._period_ns is None else 1e-9 * self._period_ns

    def refine(self, number: int, arrival_ns: int) -> int | None:
        """When the telegram would have arrived without delay, in ns of the same clock.

        None: too late or too early to be believed, or a number that does not go on from the last.
        Two such arrivals that agree with each other start a new line.
        """
        if not self._arrivals:
            return self._start(number, arrival_ns)
        last_number = self._arrivals[-1][0]
        step = (number - last_number) % _NUMBERS
        if not 0 < step <= _MAX_STEP or abs(self._lateness_ns(step, arrival_ns)) > self._limit_ns:
            return self._doubt(number, arrival_ns)
        self._doubtful, self._doubts = None, 0
        self._arrivals.append((last_number + step, arrival_ns))
        self._period_ns, height_ns = self._line()
        return arrival_ns + round(height_ns)

    def _line(self) -> tuple[float, float]:
        """Period in ns, and the line's height over the newest arrival in ns (never above 0)."""
        newest_number, newest_ns = self._arrivals[-1]
        # Differences of integers first: floats do not hold monotonic nanoseconds exactly.
        steps, delays = np.array(
            [(number - newest_number, ns - newest_ns) for number, ns in self._arrivals],
            dtype=np.float64,
        ).T
        period = _slope(steps, delays)
        if len(steps) >= _ENOUGH:
            # The later half says more about the line's delays than about the mirror.
            residuals = delays - period * steps
            prompt = residuals <= np.median(residuals)
            period = _slope(steps[prompt], delays[prompt])
        return period, float((delays - period * steps).min())

    def _lateness_ns(self, step: int, arrival_ns: int) -> float:
        if len(self._arrivals) < 2:
            return 0.0
        period, height = self._line()
        return arrival_ns - self._arrivals[-1][1] - (height + period * step)

    def _doubt(self, number: int, arrival_ns: int) -> int | None:
        before, self._doubtful = self._doubtful, (number, arrival_ns)
        self._doubts += 1
        if before is None:
            return None
        step = (number - before[0]) % _NUMBERS
        # A backlog comes in far faster than it was measured.
        live = arrival_ns - before[1] > 0.5 * step * (self._period_ns or 0.0)
        if 0 < step <= _MAX_STEP and (live or self._doubts > _MAX_DOUBTFUL):
            return self._start(number, arrival_ns)
        return None

    def _start(self, number: int, arrival_ns: int) -> int:
        self._arrivals.clear()
        self._arrivals.append((number, arrival_ns))
        self._doubtful, self._doubts = None, 0
        return arrival_ns


def _slope(x: Array, y: Array) -> float:
    spread = x - x.mean()
    return float(spread @ y / (spread @ spread))
