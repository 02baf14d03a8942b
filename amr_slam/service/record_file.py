"""The file of ``--record``, and what every file of the recorder's is written with."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from amr_slam.map.export import png_pixels
from amr_slam.recording import RecordingWriter
from amr_slam.recording.messages import Entry
from amr_slam.serving import Picture

_log = logging.getLogger(__name__)

LEAST_FREE_BYTES: Final = 256 << 20
"""Of the disk: maps and the journal must go on."""


class RecordFile:
    """The file of ``--record``. It ends early, with a warning, rather than fill the disk."""

    def __init__(self, path: Path, writer: RecordingWriter) -> None:
        self._path = path
        self._writer: RecordingWriter | None = writer
        self._shown: Picture | None = None

    def write(self, entries: Sequence[Entry], picture: Picture | None, now_ns: int) -> None:
        if self._writer is None:
            return
        try:
            if picture is not None and picture is not self._shown:
                self._shown = picture
                write_map(self._writer, picture, now_ns)
            for entry in entries:
                self._writer.add(entry)
            self._writer.flush()
            full = free_bytes(self._path) < LEAST_FREE_BYTES
        except OSError as error:
            self._end(error.strerror or str(error))
            return
        if full:
            self._end("the disk is nearly full")
        elif self._writer.is_full:
            self._end("2 GiB of messages are in it")

    def close(self) -> None:
        if self._writer is not None:
            writer, self._writer = self._writer, None
            try:
                writer.close()
            except OSError as error:
                _log.warning("%s: cut off: %s", self._path, error.strerror or error)

    def _end(self, reason: str) -> None:
        _log.warning("%s: the recording ends here: %s", self._path, reason)
        self.close()


def write_map(writer: RecordingWriter, picture: Picture, stamp_ns: int) -> None:
    """The map as it is drawn from ``stamp_ns`` on. Raises OSError."""
    at = picture.georeference
    pixels = png_pixels(picture.png)
    writer.write_map(stamp_ns, pixels, at.metres_per_px, at.column_of_x0_px, at.row_of_y0_px)


def free_bytes(path: Path) -> int:
    """Of the disk of a file or folder that need not be there yet."""
    return shutil.disk_usage(next(one for one in path.parents if one.exists())).free
