"""Scans that belong together: the scanners' newest ones become one cloud at one instant."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.arrangement import View
from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.fusion import PoseFilter
from amr_slam.geometry import Pose2
from amr_slam.mounting import Mounting
from amr_slam.samples import Outcome, Scan

_LONGEST_PERIOD_NS: Final = 2_000_000_000
"""The slowest scans that are used come at 0.5 Hz; what a period is taken for before two came."""
_MISSED_PERIODS: Final = 2.5
_LEAST_PATIENCE_NS: Final = 1_000_000_000
_STEP_S: Final = 0.02
"""Wheels are read as often."""
_MOST_STEPS: Final = 100


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Merged:
    """One cloud of one instant."""

    cloud: Cloud
    views: tuple[View, ...]
    """The scanners by which it was seen, in the order of ``cloud.scanners``."""


class Pairing:
    """Keeps the newest scan of each scanner until it is time to register them."""

    def __init__(
        self, mountings: Mapping[str, Mounting], params: CloudParams, wait_s: float
    ) -> None:
        """``wait_s``: how long a scan waits for the other scanners'."""
        self._mountings = dict(mountings)
        self._params = params
        self._wait_ns = round(1e9 * wait_s)
        self._pending: dict[str, Scan] = {}
        self._newest_ns: dict[str, int] = {}
        self._period_ns = dict.fromkeys(mountings, _LONGEST_PERIOD_NS)

    def __len__(self) -> int:
        """Scanners that the robot has."""
        return len(self._mountings)

    def on_wheels_clock(self, scan: Scan) -> Scan:
        """The scan stamped as the wheels are; one of an unknown scanner as it is."""
        mounting = self._mountings.get(scan.scanner)
        if mounting is None or mounting.lag_s == 0.0:
            return scan
        return replace(scan, stamp_ns=scan.stamp_ns - round(1e9 * mounting.lag_s))

    def check(self, scan: Scan) -> Outcome:
        """ACCEPTED, or why the scan cannot be used; its stamp is remembered."""
        if scan.scanner not in self._mountings:
            return Outcome.INVALID
        newest = self._newest_ns.get(scan.scanner)
        if newest is not None and scan.stamp_ns <= newest:
            return Outcome.DUPLICATE if scan.stamp_ns == newest else Outcome.LATE
        if newest is not None:
            self._period_ns[scan.scanner] = min(scan.stamp_ns - newest, _LONGEST_PERIOD_NS)
        self._newest_ns[scan.scanner] = scan.stamp_ns
        return Outcome.ACCEPTED

    def keep(self, scan: Scan) -> None:
        """Newest wins: an unregistered scan of this scanner is not worth waiting for."""
        self._pending[scan.scanner] = scan

    def missing(self, now_ns: int, since_ns: int) -> list[str]:
        """Scanners of which no scan came for two and a half of their periods, or for 1 s where
        that is more. ``since_ns``: when they were first waited for. Of one that is the only one,
        the age of the fixes tells."""
        if len(self) < 2:
            return []
        return [
            name
            for name, period_ns in self._period_ns.items()
            if now_ns - self._newest_ns.get(name, since_ns)
            > max(_MISSED_PERIODS * period_ns, _LEAST_PATIENCE_NS)
        ]

    def take(self, now_ns: int) -> list[Scan]:
        """The scans to register now, once; none while the other scanner's is waited for.

        ``now_ns``: how far the wheels reach; a scan is not ready before its last beam.
        """
        ready = {name: scan for name, scan in self._pending.items() if end_ns(scan) <= now_ns}
        if not ready:
            return []
        oldest_ns = min(end_ns(scan) for scan in ready.values())
        if len(ready) < len(self._mountings) and now_ns - oldest_ns < self._wait_ns:
            return []
        for name in ready:
            del self._pending[name]
        return list(ready.values())

    def merged(self, scans: Sequence[Scan], wheels: PoseFilter) -> tuple[Merged | None, int]:
        """One cloud at the newest scan's middle instant, deskewed, and the number of scans that
        were too old for that: beyond the wheels' history, or so old that their scanner should have
        sent another one since. None where none is left."""
        stamp_ns = max(scan.mid_stamp_ns for scan in scans)
        parts: list[tuple[Cloud, Pose2]] = []
        views: list[View] = []
        for scan in sorted(scans, key=lambda scan: -scan.mid_stamp_ns):
            if stamp_ns - scan.mid_stamp_ns > self._period_ns[scan.scanner]:
                continue
            to_scan = wheels.motion_between(stamp_ns, scan.mid_stamp_ns)
            sweep = _sweep(scan, wheels)
            if to_scan is None or sweep is None:
                continue
            mounting = self._mountings[scan.scanner]
            cloud = cloud_from_scan(
                mounting.masked(scan),
                mounting.base_from_lidar,
                self._params,
                upside_down=mounting.upside_down,
                sweep=sweep,
            )
            parts.append((cloud, to_scan.delta))
            views.append(
                View(
                    scanner=scan.scanner,
                    base_from_lidar=mounting.base_from_lidar,
                    upside_down=mounting.upside_down,
                    base_from_then=to_scan.delta,
                )
            )
        late = len(scans) - len(parts)
        return Merged(cloud=merge(parts), views=tuple(views)) if parts else None, late


def _sweep(scan: Scan, wheels: PoseFilter) -> list[Pose2] | None:
    """Where the base stood during a sweep, in the frame of its middle; a robot that speeds up does
    not go evenly. None where the wheels no longer know, or not yet."""
    steps = min(max(1, math.ceil(scan.sweep_s / _STEP_S)), _MOST_STEPS)
    instants = np.linspace(scan.stamp_ns, end_ns(scan), steps + 1).round()
    motions = [wheels.motion_between(scan.mid_stamp_ns, int(instant)) for instant in instants]
    poses = [motion.delta for motion in motions if motion is not None]
    return poses if len(poses) == len(motions) else None


def end_ns(scan: Scan) -> int:
    """Instant of the last beam."""
    return scan.stamp_ns + round(1e9 * scan.sweep_s)
