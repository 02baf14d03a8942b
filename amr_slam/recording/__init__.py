"""Reads and writes logs and trajectories. Nothing in a file is trusted."""

from __future__ import annotations

from pathlib import Path

from amr_slam.recording.carmen import read_carmen
from amr_slam.recording.tum import read_tum, write_tum
from amr_slam.recording.values import Log, RecordingError, Sample, Trajectory

__all__ = [
    "Log",
    "RecordingError",
    "Sample",
    "Trajectory",
    "read_log",
    "read_tum",
    "write_tum",
]

_CARMEN_SUFFIXES = (".log", ".clf", ".log.gz", ".clf.gz", ".gz")


def read_log(path: Path) -> Log:
    """The recording in ``path``: CARMEN (.log, .clf, .gz of them), by the file's name.

    Raises RecordingError when it is of another kind, damaged, or cannot be read.
    """
    if path.name.endswith(_CARMEN_SUFFIXES):
        return read_carmen(path)
    raise RecordingError(f"{path}: not a log; known are .log, .clf and .gz of them")
