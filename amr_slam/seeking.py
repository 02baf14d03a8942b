"""A pose that somebody names, until scans confirm it or speak against it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from amr_slam.evidence import apart
from amr_slam.geometry import Pose2
from amr_slam.region import Region
from amr_slam.samples import Motion, SlamPose
from amr_slam.slam_request import SlamResult

Wheels = Callable[[int, int], Motion | None]
"""What the wheels say between two instants; None when they no longer know."""

_AGREEING: Final = 2
"""Scans in a row that must find the same place: one may have seen mostly passers-by."""
_REFUSING: Final = 2
"""Scans that may find none, or another one, before the search is given up."""


class Seek:
    """One search in a region that moves along with the robot; no clock."""

    def __init__(self, stamp_ns: int, region: Region) -> None:
        """``region``: as it was at ``stamp_ns``."""
        self._stamp_ns = stamp_ns
        self._region = region
        self._found: list[SlamPose] = []
        self._refused = 0
        self.ended = False
        self.pose: Pose2 | None = None
        """Ended: where scans confirmed the robot, at their instant; None where they did not."""
        self.reason: str | None = None
        """Ended without a pose: why."""

    def give_up(self, reason: str) -> None:
        """Whatever comes in later is not heard any more."""
        self.ended, self.pose, self.reason = True, None, reason

    def region_at(self, stamp_ns: int, wheels: Wheels) -> Region | None:
        """Where to look in the scan of ``stamp_ns``; None when the search has ended."""
        motion = wheels(self._stamp_ns, stamp_ns)
        if not self.ended and motion is None:
            self.give_up("the wheels do not know the way since the pose was named")
        if self.ended or motion is None:
            return None
        return replace(self._region, map_from_base=self._region.map_from_base @ motion.delta)

    def hear(self, result: SlamResult, wheels: Wheels) -> SlamPose | None:
        """Take in what a scan says; the pose to jump to, once enough of them say the same."""
        fix = result.fix
        if fix is None:
            self._refuse(result.answer.reason or "nothing fits")
            return None
        if self._found and not _agree(self._found[-1], fix, wheels):
            self._found.clear()
            self._refuse("one scan after the other finds another place")
        self._found.append(fix)
        if self.ended or len(self._found) < _AGREEING:
            return None
        self.ended, self.pose = True, fix.map_from_base
        return fix

    def _refuse(self, reason: str) -> None:
        self._refused += 1
        if self._refused >= _REFUSING:
            self.give_up(reason)


def _agree(earlier: SlamPose, later: SlamPose, wheels: Wheels) -> bool:
    motion = wheels(earlier.stamp_ns, later.stamp_ns)
    return motion is not None and not apart(
        earlier.map_from_base @ motion.delta, later.map_from_base
    )
