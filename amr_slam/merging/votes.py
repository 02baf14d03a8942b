"""Where single scans of one map say that it lies in the other.

Each scan is sought in the whole of the other map, as a robot that knows nothing would be. What it
finds is no proof, but scans all over a map that say the same are: a hall repeats itself in one
place or two, seldom everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.evidence import Verdict
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.map import PointMap
from amr_slam.merging.scans import Rows, cloud_of
from amr_slam.params import SlamParams
from amr_slam.slam import slam_absolute_rungs

_AGREE_M: Final = 0.5
_AGREE_RAD: Final = 0.06
_BEND: Final = 0.02
"""Maps bend: what two of its scans say of a map may differ by this much of their distance."""
_LEAST_ODDS: Final = 0.02

Say = Callable[[str, float | None], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Votes:
    """What each scan said; row-aligned arrays, one row for each place that a scan was found at."""

    scans: Rows
    """(v,) row of the scan in its map's path."""
    poses: Array
    """(v, 3) of the scan, in its own map ..."""
    found: Array
    """... and (v, 3) in the other one."""
    odds: Array
    """(v,)"""
    sought: int
    """Scans that were sought ..."""
    sure: int
    """... and that were found at one place only."""

    def transform(self, vote: int) -> Pose2:
        """known_from_other by one vote."""
        found = Pose2.from_array(self.found[vote])
        return found @ Pose2.from_array(self.poses[vote]).inverse()

    def within(self, allowed: Callable[[Pose2], bool]) -> Votes:
        """The votes for allowed ways only, as somebody knows that it is none of the others."""
        kept = np.array([allowed(self.transform(vote)) for vote in range(len(self.odds))], bool)
        out = np.bincount(self.scans[~kept], self.odds[~kept], minlength=1 + self.scans.max())
        odds = self.odds / np.maximum(1.0 - out[self.scans], 1e-9)
        return replace(
            self,
            scans=self.scans[kept],
            poses=self.poses[kept],
            found=self.found[kept],
            odds=odds[kept],
        )

    def agreeing(self, way: Pose2, from_m: Array) -> NDArray[np.bool_]:
        """(v,) which votes a way foretells that is known best around ``from_m`` (2,)."""
        told = way @ self.poses[:, :2]
        away_m = np.hypot(*(self.poses[:, :2] - from_m).T)
        off_m = np.hypot(*(told - self.found[:, :2]).T)
        turn = wrap_angle(self.poses[:, 2] + way.theta_rad - self.found[:, 2])
        return np.asarray((off_m <= _AGREE_M + _BEND * away_m) & (np.abs(turn) <= _AGREE_RAD))

    def witnesses(self, way: Pose2) -> int:
        """Scans that hold a way for likelier than all others together."""
        middle = self.poses[:, :2].mean(axis=0)
        likely = self.agreeing(way, middle) & (self.odds > 0.5)
        return len(np.unique(self.scans[likely]))


def poll(
    known: PointMap,
    other: PointMap,
    rows: Rows,
    params: SlamParams,
    near: Pose2 | None,
    say: Say,
) -> Votes:
    """Seek these scans of ``other`` in ``known``. ``near``: known_from_other, roughly."""
    scans, poses, found, odds, sure = [], [], [], [], 0
    for done, row in enumerate(rows.tolist()):
        say("seeking scans", done / len(rows))
        pose = other.path[row][1]
        also = None if near is None else (near @ pose).as_array()[np.newaxis]
        for answer in slam_absolute_rungs(cloud_of(other, row), known, params, also):
            last = answer
            if answer.verdict is Verdict.ACCEPTED:
                sure += 1
                break
        for place, probable in zip(last.places, last.odds, strict=True):
            if probable >= _LEAST_ODDS:
                scans.append(row)
                poses.append(pose.as_array())
                found.append(place.pose.as_array())
                odds.append(probable)
    return Votes(
        scans=np.array(scans, dtype=np.intp),
        poses=np.array(poses).reshape(-1, 3),
        found=np.array(found).reshape(-1, 3),
        odds=np.array(odds, dtype=np.float64),
        sought=len(rows),
        sure=sure,
    )


def candidates(votes: Votes, most: int) -> list[Pose2]:
    """The ways that most is said for, best first; each vote speaks for one of them only."""
    left = np.ones(len(votes.odds), dtype=np.bool_)
    agreeing = [
        votes.agreeing(votes.transform(vote), votes.poses[vote, :2]) for vote in range(len(left))
    ]
    ways: list[Pose2] = []
    while left.any() and len(ways) < most:
        supports = [
            float(votes.odds[same & left].sum()) if left[vote] else -1.0
            for vote, same in enumerate(agreeing)
        ]
        best = int(np.argmax(supports))
        ways.append(votes.transform(best))
        left &= ~agreeing[best]
    return ways
