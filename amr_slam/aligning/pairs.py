"""The same place twice: as the site calls it, and as the map does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, readonly


class AlignError(Exception):
    """Frames that cannot be brought together: one line with the reason."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosePairs:
    """What the site's system (cameras, a survey) and the map say of the same instants or points;
    arrays are read-only and row-aligned."""

    labels: tuple[str, ...]
    """(n,) what people call each pair: a name, or a time."""
    site: Array
    """(n, 3) x m, y m, theta rad in the site's frame; theta NaN where it has none."""
    map: Array
    """(n, 3) of the base frame in the map's frame, likewise."""
    twists: Array | None = None
    """(n, 3) speed ahead m/s, to the left m/s, turn rad/s of the base at these instants; None
    where nothing is known of them."""

    def __post_init__(self) -> None:
        shape = (len(self.labels), 3)
        for name in ("site", "map", "twists"):
            values = getattr(self, name)
            if values is None:
                continue
            if values.shape != shape:
                raise ValueError(f"{name}: {values.shape}, not {shape}")
            object.__setattr__(self, name, readonly(values))
        if not np.isfinite(np.hstack([self.site[:, :2], self.map[:, :2]])).all():
            raise ValueError("positions must be finite")

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def has_map_headings(self) -> bool:
        """Whether it is known of each pair how the robot stood in the map."""
        return bool(np.isfinite(self.map[:, 2]).all()) and len(self) > 0

    @property
    def has_headings(self) -> bool:
        """Whether it is known in both frames."""
        return self.has_map_headings and bool(np.isfinite(self.site[:, 2]).all())

    def take(self, rows: NDArray[np.intp]) -> PosePairs:
        """Only these pairs."""
        return PosePairs(
            labels=tuple(self.labels[row] for row in rows),
            site=self.site[rows],
            map=self.map[rows],
            twists=None if self.twists is None else self.twists[rows],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Where a camera system saw the robot's marker over time; arrays are read-only."""

    stamps_ns: NDArray[np.int64]
    """(n,) never decreasing, on the camera system's clock."""
    poses: Array
    """(n, 3) x m, y m, theta rad; theta NaN where the system gives none."""

    def __post_init__(self) -> None:
        order = np.argsort(self.stamps_ns, kind="stable")
        object.__setattr__(self, "stamps_ns", readonly(self.stamps_ns[order], np.int64))
        object.__setattr__(self, "poses", readonly(self.poses[order]))
