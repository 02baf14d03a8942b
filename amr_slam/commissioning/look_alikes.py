"""Places that are taken for each other, gathered into pairs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from amr_slam.commissioning.cold_starts import ColdStart, Outcome
from amr_slam.geometry import Array, Pose2

# A corner that is alike at one pose alone is chance.
_LEAST = 2
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pair:
    """An area, and the one that it is taken for."""

    letter: str
    here_m: Array
    """(n, 2) places in the first area, row-aligned with those of the other one."""
    there_m: Array
    """(n, 2)."""
    starts: tuple[ColdStart, ...]
    """That were confused, each once."""
    wrong: int
    """Of these, that gave a wrong place for right."""

    @property
    def middles_m(self) -> tuple[Array, Array]:
        """The place (2,) nearest to the middle of either area."""
        return _middle(self.here_m), _middle(self.there_m)

    @property
    def same_place(self) -> bool:
        """The place is like itself, turned."""
        return float(np.median(np.hypot(*(self.here_m - self.there_m).T))) < 1.0


def pairs(tried: Sequence[ColdStart], reach_m: float) -> tuple[Pair, ...]:
    """Confusions that begin within ``reach_m`` of each other and end so, too, are one pair; it
    does not matter which of its areas the robot stands in. The largest first."""
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
        starts = tuple({id(confused[row][0]): confused[row][0] for row in rows}.values())
        if len(starts) < _LEAST:
            continue
        turned = swapped[rows, None]
        found.append(
            Pair(
                letter="",
                here_m=np.where(turned, there[rows], here[rows]),
                there_m=np.where(turned, here[rows], there[rows]),
                starts=starts,
                wrong=sum(start.outcome is Outcome.WRONG for start in starts),
            )
        )
    found.sort(key=lambda pair: (-pair.wrong, -len(pair.starts)))
    return tuple(_lettered(found))


def _lettered(found: Sequence[Pair]) -> list[Pair]:
    return [
        Pair(
            letter=_letters(number),
            here_m=pair.here_m,
            there_m=pair.there_m,
            starts=pair.starts,
            wrong=pair.wrong,
        )
        for number, pair in enumerate(found)
    ]


def _letters(number: int) -> str:
    more, last = divmod(number, len(_LETTERS))
    return (_letters(more - 1) if more else "") + _LETTERS[last]


def _grouped(here: Array, there: Array, reach_m: float) -> tuple[Array, Array]:
    """(n,) number of each confusion's group, and (n,) whether it begins in its second area.

    Each confusion stands for two nodes of a graph, one for each way round.
    """
    n = len(here)
    begin, end = np.concatenate([here, there]), np.concatenate([there, here])
    rows, columns = [], []
    for row in range(2 * n):
        near = np.hypot(*(begin - begin[row]).T) <= reach_m
        near &= np.hypot(*(end - end[row]).T) <= reach_m
        found = np.flatnonzero(near)
        rows.append(np.full(len(found), row))
        columns.append(found)
    i, j = np.concatenate(rows), np.concatenate(columns)
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(2 * n, 2 * n))
    labels = connected_components(graph, directed=False)[1]
    plain, turned = labels[:n], labels[n:]
    # Both ways round are one group, called by the lesser number.
    least = np.minimum(plain, turned)
    _, groups = np.unique(least, return_inverse=True)
    return groups, np.asarray(plain > turned)


def _middle(points: Array) -> Array:
    off = np.hypot(*(points - np.median(points, axis=0)).T)
    return np.asarray(points[int(np.argmin(off))])


def heading_between(here: Pose2, there: Pose2) -> float:
    """Turn in degrees from one to the other, 0 to 180."""
    return abs(math.degrees((here.inverse() @ there).theta_rad))
