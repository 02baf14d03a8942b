"""Is a scan new? By its counter. Pure."""

from __future__ import annotations

import enum

_WRAP = 2**16
_STANDS_STILL_S = 0.2
_PERIODS = 3.5
"""A counter that has not moved for so many turns of the mirror, and for that time, is frozen."""
_MAX_STEP = 1000
"""A larger step is no loss but a counter that began anew."""


class News(enum.Enum):
    """What a scan counter says."""

    NEW = enum.auto()
    REPEATED = enum.auto()
    FROZEN = enum.auto()


class Counting:
    """Scan counters of one device in the order of their telegrams."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._moved_ns = 0
        self._step = _MAX_STEP
        self._period_s = 0.0
        self.first_ns: int | None = None
        """Arrival of the first scan."""
        self.new = 0
        self.repeated = 0
        """Scans of a stream that came twice."""
        self.lost = 0
        """Scans of a stream that never came."""

    @property
    def telegram_s(self) -> float:
        """Time between the telegrams of a stream: some devices send every n-th scan only."""
        return self._period_s * (self._step if self._step < _MAX_STEP else 1)

    def hear(self, counter: int, period_s: float, arrival_ns: int, *, polled: bool) -> News:
        """The next telegram's counter."""
        last, self._period_s = self._last, period_s
        if counter == last:
            # A device that is asked often answers with the same scan again.
            self.repeated += int(not polled)
            still_s = 1e-9 * (arrival_ns - self._moved_ns)
            frozen = still_s > max(_STANDS_STILL_S, _PERIODS * self.telegram_s)
            return News.FROZEN if frozen else News.REPEATED
        self._last, self._moved_ns = counter, arrival_ns
        self.first_ns = arrival_ns if self.first_ns is None else self.first_ns
        self.new += 1
        if last is not None and not polled:
            self._count_lost((counter - last) % _WRAP)
        return News.NEW

    def restarted(self) -> None:
        """The device has been started again: its counter goes on from nowhere."""
        self._step = _MAX_STEP

    def _count_lost(self, step: int) -> None:
        if step >= _MAX_STEP:
            return
        self._step = min(self._step, step)
        self.lost += step // self._step - 1
