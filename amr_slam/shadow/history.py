"""The published poses of the last seconds, to be asked for any instant in them."""

from __future__ import annotations

import bisect
from collections import deque
from dataclasses import dataclass
from typing import Final

from amr_slam.geometry import Pose2, interpolate
from amr_slam.wire import PoseMessage

_KEPT_S: Final = 30.0
_MOST: Final = 6000
"""30 s at 200 Hz."""
_GAP_S: Final = 0.3
"""Poses farther apart have a hole between them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What the robot said of one instant."""

    map_from_base: Pose2
    said: PoseMessage
    """The newest message before it."""


class History:
    """Not for more than one thread."""

    def __init__(self) -> None:
        self._said: deque[PoseMessage] = deque(maxlen=_MOST)

    @property
    def newest_s(self) -> float | None:
        """UTC of the newest pose."""
        return self._said[-1].stamp if self._said else None

    def add(self, said: PoseMessage) -> None:
        """The next pose. A clock that was set back begins anew."""
        if self._said and said.stamp <= self._said[-1].stamp:
            if said.stamp == self._said[-1].stamp:
                return
            self._said.clear()
        self._said.append(said)
        while said.stamp - self._said[0].stamp > _KEPT_S:
            self._said.popleft()

    def at(self, stamp_s: float) -> Known | None:
        """Between two poses of one epoch; None outside, in a hole, or at a jump."""
        row = bisect.bisect_right(self._said, stamp_s, key=lambda said: said.stamp)
        if row == 0:
            return None
        before = self._said[row - 1]
        if before.stamp == stamp_s:
            return Known(map_from_base=_pose(before), said=before)
        if row == len(self._said):
            return None
        after = self._said[row]
        gap_s = after.stamp - before.stamp
        if gap_s > _GAP_S or (before.epoch, before.map) != (after.epoch, after.map):
            return None
        pose = interpolate(_pose(before), _pose(after), (stamp_s - before.stamp) / gap_s)
        return Known(map_from_base=pose, said=before)


def _pose(said: PoseMessage) -> Pose2:
    return Pose2(said.x, said.y, said.theta)
