"""What of a scan the map explains at a pose, what contradicts it, and where."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.registration import fit
from amr_slam.registration.alignment import Target

# The sector that is named holds this share of what contradicts: the rest are stray beams.
_MOST: Final = 0.8
_DIRECTIONS: Final = (
    "ahead",
    "ahead to the left",
    "to the left",
    "behind to the left",
    "behind",
    "behind to the right",
    "to the right",
    "ahead to the right",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A scan against the map. Shares are of the scan's surface."""

    explained: float
    """Share that lies on the map's walls."""
    contradicting: float
    """Share that stands where rays had passed, or was seen through a wall of the map."""
    sector_rad: tuple[float, float]
    """Bearings in the base frame, counter-clockwise from the first to the second (which may lie
    beyond pi), between which most of what contradicts was seen."""

    def describe(self) -> str:
        """For people: how much, and where."""
        first, last = (math.degrees(bearing) for bearing in self.sector_rad)
        where = "all around"
        if last - first < 180.0:
            middle = round((first + last) / 90.0) % 8
            where = f"{_DIRECTIONS[middle]} (bearing {first:.0f}..{last:.0f} deg)"
        return f"{self.contradicting:.0%} of the scan contradicts the map, {where}"


def compare(X: Cloud, target: Target, pose: Pose2) -> Change | None:
    """The scan at a pose against the map; None where either is empty. Shares are of what lies
    outside zones without landmarks."""
    if not len(X) or not len(target):
        return None
    moved = pose @ X.points_m
    distance = fit.distances(target, moved)
    clearance = fit.clearance(X)
    counts = fit.counts(target, moved)
    share = X.weights * counts / max(float(X.weights @ counts), 1e-9)
    appeared = target.lookup.seen_free(moved) & (distance > clearance)
    # Beams that graze a wall on the map's side pass it by their noise alone.
    through = (fit.beyond_walls(X, target, pose) > 2.0 * clearance) & (distance > clearance)
    wrong = (appeared | through) & counts
    bearings = np.arctan2(X.points_m[:, 1], X.points_m[:, 0])
    return Change(
        # Shares add up to 1 but for the rounding: all of a scan may be a little more than all.
        explained=min(1.0, float(share @ (distance <= clearance))),
        contradicting=min(1.0, float(share @ wrong)),
        sector_rad=sector(bearings[wrong], share[wrong]),
    )


def sector(bearings_rad: Array, weights: Array) -> tuple[float, float]:
    """The narrowest sector that holds most of the weight of bearings (n,): first and last bearing,
    the first in (-pi, pi]. (0, 0) without any."""
    if not len(bearings_rad):
        return 0.0, 0.0
    order = np.argsort(bearings_rad, kind="stable")
    around = np.concatenate([bearings_rad[order], bearings_rad[order] + math.tau])
    sums = np.concatenate([[0.0], np.cumsum(np.tile(weights[order], 2))])
    begin = np.arange(len(order))
    enough = sums[begin] + _MOST * weights.sum() - 1e-12
    end = np.searchsorted(sums, enough) - 1  # the row with which there is enough
    best = int(np.argmin(around[end] - around[begin]))
    return float(around[begin[best]]), float(around[end[best]])
