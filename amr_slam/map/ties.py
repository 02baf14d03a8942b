"""What is known of how a map's scans lie to each other: the pose graph that made it.

Kept with the map, so that whoever goes on with it may close its loops, and others may solve it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, readonly


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapTies:
    """One row for each pair of scans that something is known of; all arrays are read-only."""

    starts: NDArray[np.int64]
    """(m,) row of the earlier scan in the map's path."""
    ends: NDArray[np.int64]
    """(m,)."""
    deltas: Array
    """(m, 3) ``start_from_end``: x m, y m, theta rad."""
    informations: Array
    """(m, 3, 3) inverse covariance of these, in the start's frame."""
    loops: NDArray[np.bool_]
    """(m,) found by comparing places, and so perhaps wrong; else a step of the way."""

    def __post_init__(self) -> None:
        for name, dtype in (("starts", np.int64), ("ends", np.int64), ("loops", np.bool_)):
            object.__setattr__(self, name, readonly(getattr(self, name), dtype))
        object.__setattr__(self, "deltas", readonly(self.deltas).reshape(-1, 3))
        object.__setattr__(self, "informations", readonly(self.informations).reshape(-1, 3, 3))
        counts = {len(self.starts), len(self.ends), len(self.deltas), len(self.informations)}
        if counts != {len(self.loops)}:
            raise ValueError("the ties' ends, deltas and informations differ in number")

    def __len__(self) -> int:
        return len(self.starts)

    def check(self, scans: int) -> None:
        """Raise ValueError where they cannot belong to a map of so many scans."""
        if (
            np.any(self.starts < 0)
            or np.any(self.ends <= self.starts)
            or np.any(self.ends >= scans)
        ):
            raise ValueError("a tie leads to a scan that is not there")


def no_ties() -> MapTies:
    """Of a map about which nothing is known but its poses."""
    return MapTies(
        starts=np.empty(0, dtype=np.int64),
        ends=np.empty(0, dtype=np.int64),
        deltas=np.empty((0, 3)),
        informations=np.empty((0, 3, 3)),
        loops=np.empty(0, dtype=np.bool_),
    )
