"""Relations files of the SLAM benchmark: ``t1 t2 x y z roll pitch yaw`` (s, m, rad).

Source: R. Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots
27, 2009.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, readonly
from amr_slam.recording.text import read_lines
from amr_slam.recording.values import RecordingError, parse_stamp


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relations:
    """How the robot's pose at one instant looks from its pose at another, for n pairs."""

    start_ns: NDArray[np.int64]
    """(n,) read-only."""
    end_ns: NDArray[np.int64]
    """(n,) read-only."""
    start_from_end: Array
    """(n, 3) read-only: x m, y m, theta rad."""

    def __post_init__(self) -> None:
        start_ns, end_ns = readonly(self.start_ns, np.int64), readonly(self.end_ns, np.int64)
        deltas = readonly(self.start_from_end)
        if not (start_ns.shape == end_ns.shape == deltas.shape[:1] and deltas.shape[1:] == (3,)):
            raise ValueError("stamps and poses of relations differ in number")
        object.__setattr__(self, "start_ns", start_ns)
        object.__setattr__(self, "end_ns", end_ns)
        object.__setattr__(self, "start_from_end", deltas)

    def __len__(self) -> int:
        return len(self.start_ns)


def read_relations(path: Path) -> Relations:
    """The relations in a file; heights and tilts are dropped.

    Raises RecordingError on the first damaged line.
    """
    stamps: list[tuple[int, int]] = []
    deltas: list[tuple[float, float, float]] = []
    for number, line in read_lines(path):
        fields = line.split()
        try:
            deltas.append(_delta(fields))
            stamps.append((parse_stamp(fields[0]), parse_stamp(fields[1])))
        except ValueError as error:
            raise RecordingError(f"{path}:{number}: {error}") from None
    ends = np.array(stamps, dtype=np.int64).reshape(-1, 2)
    return Relations(
        start_ns=ends[:, 0],
        end_ns=ends[:, 1],
        start_from_end=np.array(deltas, dtype=np.float64).reshape(-1, 3),
    )


def _delta(fields: list[str]) -> tuple[float, float, float]:
    if len(fields) != 8:
        raise ValueError(f"{len(fields)} fields instead of 8")
    numbers = [float(field) for field in fields[2:]]
    if not all(map(math.isfinite, numbers)):
        raise ValueError("numbers must be finite")
    return numbers[0], numbers[1], numbers[5]
