"""Reads and writes logs and trajectories. Nothing in a file is trusted."""

from __future__ import annotations

from pathlib import Path

from amr_slam.recording.carmen import read_carmen
from amr_slam.recording.native import RecordingWriter, read_native
from amr_slam.recording.relations import Relations, read_relations
from amr_slam.recording.tum import read_tum, write_tum
from amr_slam.recording.values import (
    About,
    Log,
    RecordedDevice,
    RecordingError,
    Sample,
    Trajectory,
)

__all__ = [
    "About",
    "Log",
    "RecordedDevice",
    "RecordingError",
    "RecordingWriter",
    "Relations",
    "Sample",
    "Trajectory",
    "read_log",
    "read_relations",
    "read_tum",
    "write_tum",
]


def read_log(path: Path) -> Log:
    """The recording in ``path``, by the file's name: native (.mcap) or CARMEN (.log, .clf, and
    .gz of them). Raises RecordingError when it is of another kind, damaged, or cannot be read.
    """
    if path.suffix == ".mcap":
        return read_native(path)
    if path.suffix in {".log", ".clf", ".gz"}:
        return read_carmen(path)
    raise RecordingError(f"{path}: not a log; known are .mcap, .log, .clf and .gz of these two")
