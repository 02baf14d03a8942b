"""Running differences of two systems, as a whole and by zones, in bounded memory."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from amr_slam.wire import MAX_SHADOW_ZONES, ShadowZone

_LEAST, _MOST, _STEPS = 1e-5, 1e3, 400
"""Sizes are counted in classes that are 4.7 % wide: so exact is a percentile."""
_WIDTH: Final = math.log(_MOST / _LEAST) / _STEPS
_MOST_ZONES: Final = 10_000
_FEW: Final = 10
"""Zones with fewer differences are not ranked."""


class Sizes:
    """Of differences in one unit: mean, rms, greatest, percentiles."""

    def __init__(self) -> None:
        self.count = 0
        self.most = 0.0
        self._sum = self._squares = 0.0
        self._classes = np.zeros(_STEPS + 1, dtype=np.int64)

    def add(self, size: float) -> None:
        """``size`` is not negative."""
        self.count += 1
        self.most = max(self.most, size)
        self._sum += size
        self._squares += size * size
        row = math.ceil(math.log(max(size, _LEAST) / _LEAST) / _WIDTH)
        self._classes[min(row, _STEPS)] += 1

    @property
    def mean(self) -> float:
        return self._sum / max(self.count, 1)

    @property
    def rms(self) -> float:
        return math.sqrt(self._squares / max(self.count, 1))

    def percentile(self, share: float) -> float:
        """Not exceeded by ``share`` (0..1) of them, rounded up to its class."""
        if not self.count:
            return 0.0
        row = int(np.searchsorted(np.cumsum(self._classes), share * self.count))
        return min(_LEAST * math.exp(row * _WIDTH), self.most)


class Zones:
    """The same by squares of the floor, without percentiles."""

    def __init__(self, side_m: float) -> None:
        self._side_m = side_m
        self._zones: dict[tuple[int, int], list[float]] = {}

    def add(self, x_m: float, y_m: float, size_m: float) -> None:
        """A difference at a place. Beyond 10,000 zones, new ones are not told apart any more."""
        place = math.floor(x_m / self._side_m), math.floor(y_m / self._side_m)
        if place not in self._zones and len(self._zones) >= _MOST_ZONES:
            return
        zone = self._zones.setdefault(place, [0.0, 0.0, 0.0])
        zone[0] += 1.0
        zone[1] += size_m * size_m
        zone[2] = max(zone[2], size_m)

    def worst(self) -> tuple[ShadowZone, ...]:
        """By their rms, the worst first."""
        ranked = sorted(
            (zone[1] / zone[0], place) for place, zone in self._zones.items() if zone[0] >= _FEW
        )
        return tuple(
            ShadowZone(
                x=(place[0] + 0.5) * self._side_m,
                y=(place[1] + 0.5) * self._side_m,
                side_m=self._side_m,
                count=int(self._zones[place][0]),
                rms_m=math.sqrt(square),
                max_m=self._zones[place][2],
            )
            for square, place in ranked[: -MAX_SHADOW_ZONES - 1 : -1]
        )


class Comparison:
    """All differences since one instant, in one map."""

    def __init__(self, map_id: str | None, since_s: float, zone_m: float) -> None:
        self.map_id, self.since_s = map_id, since_s
        self.way, self.turn = Sizes(), Sizes()
        self.zones = Zones(zone_m)
        self._sum = np.zeros(3)

    def add(self, x_m: float, y_m: float, difference: tuple[float, float, float | None]) -> None:
        """Camera less robot (dx m, dy m, dtheta rad or None), at a place in the map."""
        dx_m, dy_m, dtheta_rad = difference
        size_m = math.hypot(dx_m, dy_m)
        self.way.add(size_m)
        self.zones.add(x_m, y_m, size_m)
        self._sum += (dx_m, dy_m, dtheta_rad or 0.0)
        if dtheta_rad is not None:
            self.turn.add(abs(dtheta_rad))

    @property
    def bias(self) -> tuple[float, float, float]:
        """Mean (dx m, dy m, dtheta rad): not every camera tells a heading each time."""
        counts = (self.way.count, self.way.count, self.turn.count)
        x, y, theta = (self._sum / np.maximum(counts, 1)).tolist()
        return x, y, theta
