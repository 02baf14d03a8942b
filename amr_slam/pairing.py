"""Scans that belong together: the scanners' newest ones become one cloud at one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.fusion import PoseFilter
from amr_slam.geometry import Pose2
from amr_slam.samples import Outcome, Scan


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """Where a scanner sits on the robot."""

    base_from_lidar: Pose2
    upside_down: bool = False
    lag_s: float = 0.0
    """How late its stamps are against the wheels' clock."""


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
        self._newest_ns[scan.scanner] = scan.stamp_ns
        return Outcome.ACCEPTED

    def keep(self, scan: Scan) -> None:
        """Newest wins: an unregistered scan of this scanner is not worth waiting for."""
        self._pending[scan.scanner] = scan

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

    def merged(self, scans: Sequence[Scan], wheels: PoseFilter) -> tuple[Cloud | None, int]:
        """One cloud at the newest scan's middle instant, deskewed, and the number of scans that
        were too old for that. None where none is left."""
        stamp_ns = max(scan.mid_stamp_ns for scan in scans)
        parts: list[tuple[Cloud, Pose2]] = []
        for scan in sorted(scans, key=lambda scan: -scan.mid_stamp_ns):
            to_scan = wheels.motion_between(stamp_ns, scan.mid_stamp_ns)
            first = wheels.motion_between(scan.mid_stamp_ns, scan.stamp_ns)
            last = wheels.motion_between(scan.mid_stamp_ns, end_ns(scan))
            if to_scan is None or first is None or last is None:
                continue
            mounting = self._mountings[scan.scanner]
            cloud = cloud_from_scan(
                scan,
                mounting.base_from_lidar,
                self._params,
                upside_down=mounting.upside_down,
                sweep=(first.delta, last.delta) if scan.sweep_s > 0.0 else None,
            )
            parts.append((cloud, to_scan.delta))
        return merge(parts) if parts else None, len(scans) - len(parts)


def end_ns(scan: Scan) -> int:
    """Instant of the last beam."""
    return scan.stamp_ns + round(1e9 * scan.sweep_s)
