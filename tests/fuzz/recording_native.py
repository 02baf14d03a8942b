"""Native recordings (MCAP): the file's frame, its records, the messages in them."""

from __future__ import annotations

import contextlib
import os
import struct
import tempfile
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.geometry import Pose2
from amr_slam.recording.native import RecordingWriter, read_native
from amr_slam.recording.values import RecordingError
from amr_slam.samples import Scan, WheelSample

_MAGIC: Final = b"\x89MCAP0\r\n"
_DATA_END: Final = 0x0F
# A file without a disk: the reader opens it by its path.
_FILE: Final = os.memfd_create("recording")
_PATH: Final = Path(f"/proc/self/fd/{_FILE}")


def target(data: bytes) -> None:
    """First byte: whether what follows is a file, or records between a head and an end."""
    if not data:
        return
    content = data[1:]
    if data[0] & 1:
        end = struct.pack("<BQI", _DATA_END, 4, 0)
        content = _MAGIC + content + end + _MAGIC
    os.ftruncate(_FILE, 0)
    os.pwrite(_FILE, content, 0)
    with contextlib.suppress(RecordingError):
        log = read_native(_PATH)
        assert all(sample.stamp_ns >= 0 for sample in log.samples)


def seeds() -> list[bytes]:
    """A scan and wheels, whole and as records; an empty recording."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        with RecordingWriter(path):
            pass
        empty = path.read_bytes()
        with RecordingWriter(path) as writer:
            writer.write(
                Scan(
                    scanner="front",
                    stamp_ns=5,
                    ranges_m=np.array((1.0, np.inf, np.nan)),
                    angle_min_rad=-1.0,
                    angle_step_rad=1.0,
                )
            )
            writer.write(WheelSample(stamp_ns=6, left_rad=1.0, right_rad=2.0))
            writer.write_truth(7, Pose2(1.0, 2.0, 3.0))
        full = path.read_bytes()
    return [b"\x00" + empty, b"\x00" + full, b"\x01" + full[len(_MAGIC) : -len(_MAGIC)]]
