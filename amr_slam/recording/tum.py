"""TUM trajectories: lines ``t x y 0 0 0 qz qw`` (s, m, unit quaternion)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from amr_slam.recording.text import read_lines
from amr_slam.recording.values import RecordingError, Trajectory, parse_stamp

# Digits that files carry: a quaternion further than this from unit length is damage.
_NORM_TOLERANCE = 1e-3


def read_tum(path: Path) -> Trajectory:
    """The trajectory in a plain or gzip TUM file, sorted by stamp; heights and tilts are dropped.

    Raises RecordingError on the first damaged line.
    """
    stamps: list[int] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in read_lines(path):
        fields = line.split()
        try:
            poses.append(_pose(fields))
            stamps.append(parse_stamp(fields[0]))
        except ValueError as error:
            raise RecordingError(f"{path}:{number}: {error}") from None
    order = np.argsort(np.array(stamps, dtype=np.int64), kind="stable")
    return Trajectory(
        stamps_ns=np.array(stamps, dtype=np.int64)[order],
        poses=np.array(poses, dtype=np.float64).reshape(-1, 3)[order],
    )


def _pose(fields: list[str]) -> tuple[float, float, float]:
    if len(fields) != 8:
        raise ValueError(f"{len(fields)} fields instead of 8")
    numbers = [float(field) for field in fields[1:]]
    x, y, _, qx, qy, qz, qw = numbers
    if not all(map(math.isfinite, numbers)):
        raise ValueError("numbers must be finite")
    norm = math.hypot(qx, qy, qz, qw)
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        raise ValueError(f"quaternion of length {norm:.6f}, must be 1")
    return x, y, math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """One line a pose; stamps to the nanosecond, the same trajectory always the same bytes."""
    with path.open("w", encoding="ascii", newline="\n") as stream:
        for stamp_ns, (x, y, theta) in zip(
            trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), strict=True
        ):
            seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
            qz, qw = math.sin(0.5 * theta), math.cos(0.5 * theta)
            stream.write(f"{seconds}.{rest_ns:09d} {x:.6f} {y:.6f} 0 0 0 {qz:.9f} {qw:.9f}\n")
