"""A device's own clock, mapped to ours. Pure.

Telegrams say when they were sent by the device's clock, and we know when they arrived. They can
arrive late but never early, so that all (device time, arrival) lie on or above one line; the lower
convex hull of the points holds it, and no clock is off by more than some 100 ppm, which keeps the
line straight while there are few points (fact sheet, B.6).
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import median

_BUCKET_NS = 4_000_000_000
"""Of so much device time only the promptest telegram says anything."""
_BUCKETS = 128
_REORDER_NS = 1_000_000_000
"""A count that goes back by less is a telegram overtaken by another, by more a device that has
started anew."""
_TELLING_NS = 30_000_000_000
"""Span from which on the drift is worth reading."""


class DeviceClock:
    """Counts of a device's clock to nanoseconds of ours, from telegrams as they arrive.

    ``tick_ns``: what one count lasts. ``modulus``: where the counter wraps. ``drift_ppm``: how far
    the device's clock may be off ours.
    """

    def __init__(
        self, *, tick_ns: int = 1000, modulus: int = 2**32, drift_ppm: float = 200.0
    ) -> None:
        self._tick_ns = tick_ns
        self._modulus = modulus
        self._bound = 1e-6 * drift_ppm
        self._points: deque[tuple[int, int]] = deque(maxlen=_BUCKETS)
        self._count = 0
        self._device_ns = 0  # of the newest count, unwrapped
        self._excess = 0.0  # slope of the line - 1
        self._anchor = (0, 0)  # a point that the line passes through
        self.restarts = 0
        """How often the counter began anew: the device has been started again."""

    @property
    def drift_ppm(self) -> float | None:
        """How much slower than ours the device's clock runs; None before it is known."""
        if not self._points or self._points[-1][0] - self._points[0][0] < _TELLING_NS:
            return None
        return 1e6 * self._excess

    def hear(self, count: int, arrival_ns: int, late_limit_ns: int) -> bool:
        """A telegram sent at ``count`` arrived at ``arrival_ns``.

        False: it came more than ``late_limit_ns`` after what the other telegrams promise, so it
        waited somewhere and what it says is old. Nothing is learnt from it.
        """
        if not self._points:
            self._start(count, arrival_ns)
            return True
        step_ns = self._step_ns(count)
        late_ns = arrival_ns - self.at(count)
        slack_ns = late_limit_ns + round(self._bound * abs(step_ns))
        if step_ns < -_REORDER_NS or late_ns < -slack_ns:
            self.restarts += int(step_ns < -_REORDER_NS or late_ns < -_REORDER_NS)
            self._start(count, arrival_ns)
            return True
        if late_ns > slack_ns:
            return False
        device_ns = self._device_ns + step_ns
        if step_ns > 0:
            self._count, self._device_ns = count, device_ns
        self._learn(device_ns, arrival_ns)
        return True

    def at(self, count: int) -> int:
        """Our time in ns when the device's clock said ``count``, less than half a wrap away.

        A telegram must have been heard. What the line's shortest delay is cannot be known: it
        remains in the result.
        """
        device_ns, our_ns = self._anchor
        since_ns = self._device_ns + self._step_ns(count) - device_ns
        return our_ns + since_ns + round(self._excess * since_ns)

    def _step_ns(self, count: int) -> int:
        """From the newest count to this one, the short way round."""
        half = self._modulus // 2
        return ((count - self._count + half) % self._modulus - half) * self._tick_ns

    def _start(self, count: int, arrival_ns: int) -> None:
        self._points.clear()
        self._count, self._device_ns, self._excess = count, 0, 0.0
        self._anchor = (0, arrival_ns)
        self._points.append((0, arrival_ns))

    def _learn(self, device_ns: int, arrival_ns: int) -> None:
        newest = self._points[-1]
        if device_ns // _BUCKET_NS > newest[0] // _BUCKET_NS:
            self._points.append((device_ns, arrival_ns))
        elif device_ns >= _bucket_start(newest) and arrival_ns - device_ns < newest[1] - newest[0]:
            self._points[-1] = (device_ns, arrival_ns)
        else:
            return
        self._fit()

    def _fit(self) -> None:
        """The line under all points that is nearest to them on average, its slope bounded."""
        first_device, first_our = self._points[0]
        # Differences of integers first: floats do not hold monotonic nanoseconds exactly.
        points = [(x - first_device, (y - first_our) - (x - first_device)) for x, y in self._points]
        slope = max(-self._bound, min(self._bound, _slope_below(points)))
        # While delays scatter by more than clocks may drift apart, they say little of the drift.
        scatter = median(y - slope * x for x, y in points) - min(y - slope * x for x, y in points)
        room = self._bound * points[-1][0]
        self._excess = slope * room**2 / (room**2 + scatter**2) if room else 0.0
        x, excess = min(points, key=lambda point: point[1] - self._excess * point[0])
        self._anchor = (first_device + x, first_our + x + excess)


def _bucket_start(point: tuple[int, int]) -> int:
    return point[0] // _BUCKET_NS * _BUCKET_NS


def _slope_below(points: list[tuple[int, int]]) -> float:
    """Slope of the lower convex hull of points with rising x, over their mean x; 0 for one."""
    hull: list[tuple[int, int]] = []
    for x, y in points:
        while len(hull) >= 2:
            (x0, y0), (x1, y1) = hull[-2:]
            if (y1 - y0) * (x - x0) < (y - y0) * (x1 - x0):
                break
            hull.pop()
        hull.append((x, y))
    middle = sum(x for x, _ in points) / len(points)
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x1 >= middle:
            return (y1 - y0) / (x1 - x0)
    return 0.0
