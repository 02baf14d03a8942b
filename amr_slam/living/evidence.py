"""What passes have said of each cell, in bounded memory.

A pass is one look at a cell, from when it comes into sight until it has been out of sight for a
while. Scans vote within a pass; passes count. One that says "as the map has it" ends a change.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.living.params import WatchParams
from amr_slam.map.grid import Keys

COLUMNS: Final = {
    "key": "<i8",
    "passes": "<i8",
    "since_ns": "<i8",
    "seen_ns": "<i8",
    "begun_ns": "<i8",
    "last_ns": "<i8",
    "first_ns": "<i8",
    "newest_ns": "<i8",
    "changed": "<i8",
    "unchanged": "<i8",
}
"""Of one cell: its key in the map's space grid; passes in a row that have shown the change, when
the first of them began to, when the last one did; then the pass under way: its begin, its newest
look, the first and the newest that showed the change, and how many did and did not. UTC ns."""
_TYPE: Final = np.dtype(list(COLUMNS.items()))
Rows = NDArray[np.void]

# So many scans for one that says no: legs hide, beams graze.
_TO_ONE: Final = 2
_LEAST_SCANS: Final = 2


class Evidence:
    """Of one kind of change; rows ascend by key."""

    def __init__(self, params: WatchParams) -> None:
        self._params = params
        self.rows: Rows = np.empty(0, dtype=_TYPE)

    def __len__(self) -> int:
        return len(self.rows)

    def note(self, changed: Keys, unchanged: Keys, now_ns: int) -> None:
        """One scan's votes, at UTC ``now_ns``. Keys ascend, none twice; a cell that was never seen
        changed is not kept."""
        self._add(np.setdiff1d(changed, self.rows["key"], assume_unique=True), now_ns)
        yes = np.searchsorted(self.rows["key"], changed)
        no = np.flatnonzero(np.isin(self.rows["key"], unchanged, assume_unique=True))
        touched = np.union1d(yes, no)
        self.rows[touched] = self._turned_over(self.rows[touched], now_ns)
        rows = self.rows
        rows["first_ns"][yes] = np.where(rows["changed"][yes] > 0, rows["first_ns"][yes], now_ns)
        rows["newest_ns"][yes] = now_ns
        rows["changed"][yes] += 1
        rows["unchanged"][no] += 1
        rows["last_ns"][touched] = now_ns
        if len(rows) > self._params.most_cells:
            self._prune(now_ns)

    def shown(self) -> Rows:
        """The cells whose last passes have shown a change, the one under way included."""
        rows = self._closed(self.rows)
        return rows[rows["passes"] > 0]

    def keep(self, keys: Keys) -> None:
        """Forget all other cells."""
        self.rows = self.rows[np.isin(self.rows["key"], keys)]

    def tidy(self, now_ns: int) -> None:
        """Forget the cells that passes have cleared."""
        self.rows = self.rows[self._worth_keeping(now_ns)]

    def _add(self, keys: Keys, now_ns: int) -> None:
        fresh = np.zeros(len(keys), dtype=_TYPE)
        fresh["key"], fresh["begun_ns"], fresh["last_ns"] = keys, now_ns, now_ns
        merged = np.concatenate([self.rows, fresh])
        self.rows = merged[np.argsort(merged["key"], kind="stable")]

    def _turned_over(self, rows: Rows, now_ns: int) -> Rows:
        """Rows of which a new look at ``now_ns`` is another pass, with the old one counted."""
        # A clock that was set back is another pass too.
        over = np.abs(now_ns - rows["last_ns"]) > round(1e9 * self._params.apart_s)
        over |= now_ns - rows["begun_ns"] > round(1e9 * self._params.longest_s)
        rows[over] = self._closed(rows[over])
        rows["begun_ns"][over] = now_ns
        return rows

    def _closed(self, rows: Rows) -> Rows:
        """A copy with the pass under way counted and ended."""
        rows = rows.copy()
        shows, denies = self._verdicts(rows)
        begins = shows & (rows["passes"] == 0)
        rows["since_ns"][begins] = rows["first_ns"][begins]
        rows["seen_ns"][shows] = rows["newest_ns"][shows]
        rows["passes"][shows] += 1
        rows["passes"][denies] = 0
        for name in ("first_ns", "newest_ns", "changed", "unchanged"):
            rows[name] = 0
        return rows

    def _verdicts(self, rows: Rows) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        changed, unchanged = rows["changed"], rows["unchanged"]
        denies = (unchanged > 0) & (changed < _TO_ONE * unchanged)
        stood_ns = rows["newest_ns"] - rows["first_ns"]
        shows = ~denies & (changed >= _LEAST_SCANS)
        shows &= stood_ns >= round(1e9 * self._params.standing_s)
        return np.asarray(shows), np.asarray(denies)

    def _worth_keeping(self, now_ns: int) -> NDArray[np.bool_]:
        """Cells that show a change, or whose pass is not over."""
        under_way = np.abs(now_ns - self.rows["last_ns"]) <= round(1e9 * self._params.apart_s)
        return np.asarray(under_way | (self._closed(self.rows)["passes"] > 0))

    def _prune(self, now_ns: int) -> None:
        self.tidy(now_ns)
        # A tenth is made free at once, so that this is not done with each scan.
        most = self._params.most_cells
        if len(self.rows) > most:
            closed = self._closed(self.rows)
            worst = np.lexsort((closed["last_ns"], closed["passes"]))
            self.rows = self.rows[np.sort(worst[len(worst) - round(0.9 * most) :])]


def checked(raw: dict[str, NDArray[Any]], params: WatchParams) -> Evidence:
    """From columns as a file holds them. Raises ValueError for what cannot be."""
    evidence = Evidence(params)
    rows = np.zeros(len(raw["key"]), dtype=_TYPE)
    for name in COLUMNS:
        rows[name] = raw[name]
    if np.any(np.diff(rows["key"]) <= 0) or any(np.any(rows[name] < 0) for name in COLUMNS):
        raise ValueError("cells must ascend, and count from 0 on")
    evidence.rows = rows
    return evidence
