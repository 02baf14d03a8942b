"""Does a scanner see the robot itself? What ``check --probe`` makes of a few scans."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from amr_slam.geometry import Array
from amr_slam.mounting import Mounting
from amr_slam.samples import Scan

_NEAR_M: Final = 0.5
_STEADY_M: Final = 0.03
_LEAST_SCANS: Final = 5
_LEAST_BEAMS: Final = 3
_BESIDE_DEG: Final = 1.0
_BEHIND_M: Final = 0.1


def own_body(scans: Sequence[Scan], mounting: Mounting) -> Iterator[str]:
    """A line for each cluster of beams that always read the same short range, with the mask that
    would drop it. What stands still beside a parked robot looks the same: the reader decides."""
    if len(scans) < _LEAST_SCANS or len({len(scan.ranges_m) for scan in scans}) > 1:
        return
    ranges = np.array([mounting.masked(scan).ranges_m for scan in scans])
    near = np.all(np.isfinite(ranges) & (ranges < _NEAR_M), axis=0)
    low = np.where(near, np.where(near, ranges, 0.0).min(axis=0), np.nan)
    high = np.where(near, np.where(near, ranges, 0.0).max(axis=0), np.nan)
    with np.errstate(invalid="ignore"):
        beams = np.flatnonzero(near & (high - low <= _STEADY_M))
    for cluster in np.split(beams, np.flatnonzero(np.diff(beams) > 2) + 1):
        if len(cluster) >= _LEAST_BEAMS:
            bearings = np.degrees(mounting.bearings_rad(scans[0])[cluster])
            yield _proposal(bearings, low[cluster], high[cluster])


def _proposal(bearings_deg: Array, low_m: Array, high_m: Array) -> str:
    first = math.floor(float(bearings_deg.min()) - _BESIDE_DEG)
    last = math.ceil(float(bearings_deg.max()) + _BESIDE_DEG)
    closer_m = math.ceil(10.0 * (float(high_m.max()) + _BEHIND_M)) / 10.0
    return (
        f"always reads {low_m.min():.2f} to {high_m.max():.2f} m at {bearings_deg.min():.1f} to "
        f"{bearings_deg.max():.1f} deg; if that is the robot itself: masks = "
        f"[{{ from_deg = {first:.1f}, to_deg = {last:.1f}, closer_than_m = {closer_m:.1f} }}]"
    )
