"""Places that are taken for each other, gathered into pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from amr_slam.commissioning.cold_starts import ColdStart, Outcome
from amr_slam.geometry import Array, Pose2

Rows = NDArray[np.intp]

# A corner that is alike at one pose alone is chance.
_LEAST = 2
# Rivals this near to each other are the same place.
_SAME_M = 1.5
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True, slots=True, kw_only=True)
class Confusion:
    """A cold start, and where the robot may as well be, as far as one pair of places goes."""

    start: ColdStart
    rivals: tuple[Pose2, ...]

    def remains_in(self, again: ColdStart) -> bool:
        """Whether the same cold start, tried again in another map, is still so confused."""
        if again.outcome in {Outcome.WRONG, Outcome.BLIND}:
            return True
        return any(
            rival.distance_to(other) <= _SAME_M for rival in again.rivals for other in self.rivals
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pair:
    """An area, and the one that it is taken for."""

    letter: str
    here_m: Array
    """(n, 2) places in the first area, row-aligned with those of the other one."""
    there_m: Array
    """(n, 2)."""
    confused: tuple[Confusion, ...]
    """Each cold start once."""

    @property
    def wrong(self) -> int:
        """How many of them gave a wrong place for right."""
        return sum(one.start.outcome is Outcome.WRONG for one in self.confused)

    @property
    def middles_m(self) -> tuple[Array, Array]:
        """The place (2,) nearest to the middle of either area."""
        return _middle(self.here_m), _middle(self.there_m)

    @property
    def same_place(self) -> bool:
        """The place is like itself, turned."""
        return float(np.median(np.hypot(*(self.here_m - self.there_m).T))) < 1.0


def pairs(tried: Sequence[ColdStart], reach_m: float) -> tuple[Pair, ...]:
    """Confusions that begin within about ``reach_m`` of one of them and end so, too, are one pair;
    it does not matter which of its areas the robot stands in. The largest first."""
    confused = [
        (start, rival)
        for start in tried
        if start.outcome in {Outcome.ALIKE, Outcome.WRONG}
        for rival in start.rivals
    ]
    if not confused:
        return ()
    here = np.array([start.truth.translation for start, _ in confused])
    there = np.array([rival.translation for _, rival in confused])
    groups, swapped = _grouped(here, there, reach_m)
    found = []
    for group in range(int(groups.max()) + 1):
        rows = np.flatnonzero(groups == group)
        rivals: dict[ColdStart, list[Pose2]] = {}
        for row in rows:
            start, rival = confused[row]
            rivals.setdefault(start, []).append(rival)
        if len(rivals) < _LEAST:
            continue
        turned = swapped[rows, None]
        found.append(
            Pair(
                letter="",
                here_m=np.where(turned, there[rows], here[rows]),
                there_m=np.where(turned, here[rows], there[rows]),
                confused=tuple(
                    Confusion(start=start, rivals=tuple(others)) for start, others in rivals.items()
                ),
            )
        )
    found.sort(key=lambda pair: (-pair.wrong, -len(pair.confused)))
    return tuple(replace(pair, letter=_letters(row)) for row, pair in enumerate(found))


def _letters(number: int) -> str:
    more, last = divmod(number, len(_LETTERS))
    return (_letters(more - 1) if more else "") + _LETTERS[last]


def _grouped(here: Array, there: Array, reach_m: float) -> tuple[Rows, NDArray[np.bool_]]:
    """(n,) number of each confusion's group, and (n,) whether it begins in its second area.

    Time and again, the confusion with most others around both its ends takes them. Chains of
    neighbours would not do: they run through a symmetric hall until both areas are all of it.
    """
    n = len(here)
    begin, end = np.concatenate([here, there]), np.concatenate([there, here])
    # Each confusion stands for two rows, one for each way round.
    near = cdist(here, begin) + cdist(there, end)
    plain, turned = near[:, :n], near[:, n:]
    swapped, off = turned < plain, np.minimum(plain, turned)
    together = off <= 2.0 * reach_m
    groups = np.full(n, -1, dtype=np.intp)
    ways = np.zeros(n, dtype=np.bool_)
    number = 0
    while np.any(groups < 0):
        free = groups < 0
        middle = int(np.argmax(np.where(free, (together & free).sum(axis=1), -1)))
        mine = together[middle] & free
        groups[mine], ways[mine] = number, swapped[middle, mine]
        number += 1
    return groups, ways


def _middle(points: Array) -> Array:
    off = np.hypot(*(points - np.median(points, axis=0)).T)
    return np.asarray(points[int(np.argmin(off))])
