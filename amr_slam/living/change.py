"""What has changed: one thing that is new or gone, with its place, age and witnesses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.geometry import Array, readonly

Kind = Literal["new", "gone"]

# Cells this far apart belong to one thing: the sides of a box may be seen in part only.
_GAP_CELLS = 3.2
# Fewer cells are beams that strayed, or a thing too small to matter.
_LEAST_CELLS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapChange:
    """One thing that stands where the map has free floor (new), or the other way round (gone)."""

    number: int
    """From 1, in the order of ``since_s``: by it a person accepts."""
    kind: Kind
    cells_m: Array
    """(n, 2) centres of the cells that its outline was seen in, in the map frame; read-only."""
    cell_m: float
    """Side of these cells."""
    since_s: float | None
    """UTC seconds when it was first seen so, without a pass to the contrary since then; None
    where two maps were compared."""
    seen_s: float | None
    """UTC seconds when it was last seen so."""
    passes: int | None
    """Passes in a row that have shown it: the median over its cells."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells_m", readonly(self.cells_m))

    @property
    def box_m(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max)."""
        low = self.cells_m.min(axis=0) - 0.5 * self.cell_m
        high = self.cells_m.max(axis=0) + 0.5 * self.cell_m
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @property
    def centre_m(self) -> tuple[float, float]:
        """Middle of the box."""
        x_min, y_min, x_max, y_max = self.box_m
        return 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)

    @property
    def area_m2(self) -> float:
        """Of the box: what is inside an outline nobody has seen."""
        x_min, y_min, x_max, y_max = self.box_m
        return (x_max - x_min) * (y_max - y_min)

    def as_json(self) -> dict[str, Any]:
        """Plain values, for ``map diff --json``."""
        x_m, y_m = self.centre_m
        return {
            "number": self.number,
            "kind": self.kind,
            "x_m": round(x_m, 3),
            "y_m": round(y_m, 3),
            "box_m": [round(side, 3) for side in self.box_m],
            "cells": len(self.cells_m),
            "since_s": self.since_s,
            "seen_s": self.seen_s,
            "passes": self.passes,
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapDiff:
    """All that has changed in a map."""

    changes: tuple[MapChange, ...]
    against: str
    """What the map was compared with, for people: a file, or what was watched."""

    def of(self, kind: Kind) -> tuple[MapChange, ...]:
        return tuple(change for change in self.changes if change.kind == kind)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangedCells:
    """Cells of one kind, row by row; stamps in UTC ns, 0 where nobody knows."""

    kind: Kind
    centres_m: Array
    """(n, 2)."""
    passes: NDArray[np.int64]
    since_ns: NDArray[np.int64]
    seen_ns: NDArray[np.int64]


def things_of(cells: Sequence[ChangedCells], cell_m: float) -> tuple[MapChange, ...]:
    """Cells that lie together make one change; numbered, the oldest first."""
    found = [change for part in cells for change in _grouped(part, cell_m)]
    found.sort(key=lambda change: (change.since_s or 0.0, change.kind, *change.centre_m))
    return tuple(replace(change, number=row) for row, change in enumerate(found, start=1))


def _grouped(cells: ChangedCells, cell_m: float) -> list[MapChange]:
    count = len(cells.centres_m)
    if count < _LEAST_CELLS:
        return []
    pairs = scipy.spatial.cKDTree(cells.centres_m).query_pairs(
        _GAP_CELLS * cell_m, output_type="ndarray"
    )
    links = scipy.sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count))
    groups = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    things: list[MapChange] = []
    for group in range(int(groups.max()) + 1):
        rows = np.flatnonzero(groups == group)
        if len(rows) < _LEAST_CELLS:
            continue
        since_ns = int(np.median(cells.since_ns[rows]))
        things.append(
            MapChange(
                number=0,
                kind=cells.kind,
                cells_m=cells.centres_m[rows],
                cell_m=cell_m,
                since_s=1e-9 * since_ns if since_ns else None,
                seen_s=1e-9 * int(cells.seen_ns[rows].max()) if since_ns else None,
                passes=int(np.median(cells.passes[rows])) if since_ns else None,
            )
        )
    return things
