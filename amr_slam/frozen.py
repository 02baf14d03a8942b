"""A scanner that sends the same scan again and again, though its line and its counter live."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.geometry import Pose2
from amr_slam.samples import Motion, Scan

Wheels = Callable[[int, int], Motion | None]
"""What the wheels say between two instants; None when they do not know."""

_SCANS: Final = 3
"""So many bit-identical scans in a row are a fault of the scanner. The second is already not used:
of 35,000 recorded scans none was the same as the one before."""
_READINGS: Final = 30
"""Fewer readings than this may repeat: an empty yard is no fault."""
_STANDS: Final = 1e-3
_MOVED: Final = 0.05
"""m or rad between two scans, and over the identical ones."""


@dataclass(slots=True, kw_only=True, eq=False)
class _Line:
    """What is known of one scanner."""

    last: Scan
    alike: int = 1
    """Identical scans in a row, the last one included."""
    way: float = 0.0
    """m and rad, each summed, the greater one: the wheels' way during them."""
    noisy: bool = False
    """Its readings have changed while the wheels stood."""


class FrozenScans:
    """Tells scanners that are frozen. No clock: same scans and wheels, same answers.

    A simulated scanner may have no noise and repeats itself while the robot stands. So identical
    scans count while the wheels turn, or once the scanner has shown that it has noise.
    """

    def __init__(self) -> None:
        self._lines: dict[str, _Line] = {}
        self._frozen: set[str] = set()

    @property
    def names(self) -> frozenset[str]:
        """Scanners whose newest scan was the third identical one, or a later one."""
        return frozenset(self._frozen)

    def repeats(self, scan: Scan, wheels: Wheels) -> bool:
        """Whether this scan must not be used, being the same as the one before."""
        line = self._lines.get(scan.scanner)
        if line is None:
            self._lines[scan.scanner] = _Line(last=scan)
            return False
        before, line.last = line.last, scan
        motion = wheels(before.stamp_ns, scan.stamp_ns)
        way = None if motion is None or motion.gap else _way(motion.delta)
        self._frozen.discard(scan.scanner)
        if not np.array_equal(before.ranges_m, scan.ranges_m, equal_nan=True):
            line.alike, line.way = 1, 0.0
            line.noisy |= way is not None and way < _STANDS and _differ(before, scan)
            return False
        line.alike += 1
        line.way += way or 0.0
        told = line.noisy or line.way > _MOVED
        readings = int(np.isfinite(scan.ranges_m).sum())
        if not told or readings < _READINGS:
            return False
        if line.alike >= _SCANS:
            self._frozen.add(scan.scanner)
        return True


def _way(delta: Pose2) -> float:
    return max(delta.distance_to(Pose2.identity()), abs(delta.theta_rad))


def _differ(before: Scan, scan: Scan) -> bool:
    """Whether most readings changed: noise does that, a passer-by does not."""
    if len(before.ranges_m) != len(scan.ranges_m):
        return False
    both = np.isfinite(before.ranges_m) & np.isfinite(scan.ranges_m)
    changed = before.ranges_m[both] != scan.ranges_m[both]
    return len(changed) >= _READINGS and bool(changed.mean() > 0.2)
