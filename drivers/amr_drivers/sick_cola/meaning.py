"""What the raw values of a scan telegram mean. Pure (fact sheet, B.5)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.scandata import Channel

ANGLE_UNITS = 10_000
"""Start angles and steps come in 1/10000 degree."""
_LOWEST_DISTANCE = 16
"""Raw distances below are codes (0 no valid measurement, 1 dazzled, ...), not millimetres."""
_HIGHEST_DISTANCE = 0xFFFF
"""The largest number says "beyond", wherever the scale puts it."""
_SNAPPED_FROM = 100
"""Smaller steps lie so close to each other's fractions that snapping would be guessing."""


def exact_step_deg(field: int) -> float:
    """The angular step behind the rounded field: 3333 is 1/3 degree, 1667 and 1666 are 1/6.

    811 steps of 0.3333 degree would end 0.027 degree short.
    """
    if field >= _SNAPPED_FROM:
        for degrees in (1, 2):
            parts = max(1, round(degrees * ANGLE_UNITS / field))
            if abs(degrees * ANGLE_UNITS / parts - field) < 1.0:
                return degrees / parts
    return field / ANGLE_UNITS


def ranges_of(channel: Channel, range_max_m: float) -> NDArray[np.float64]:
    """(n,) ranges in m of a DIST channel: NaN for no measurement, +inf beyond ``range_max_m``.

    The code 0 is no measurement as well: these scanners say it for "no echo" and for "could not
    measure" alike, so it does not claim free space; only an echo from further away does. Raises
    BadTelegram for a scale or an offset that makes no distances.
    """
    scale, offset = channel.scale, channel.offset
    if not (math.isfinite(scale) and math.isfinite(offset) and scale > 0.0):
        raise BadTelegram(f"{channel.name} has the scale {scale:g} and the offset {offset:g}")
    ranges = 1e-3 * (channel.values.astype(np.float64) * scale + offset)
    codes = (channel.values < _LOWEST_DISTANCE) | (channel.values == _HIGHEST_DISTANCE)
    ranges[ranges > range_max_m] = np.inf
    ranges[codes | (ranges <= 0.0)] = np.nan
    return ranges
