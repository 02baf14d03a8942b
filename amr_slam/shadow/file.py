"""Pairs of poses as a table that grows, within a bound."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Final, TextIO

_log = logging.getLogger(__name__)

HEADER: Final = (
    "stamp,camera_x,camera_y,camera_theta,slam_x,slam_y,slam_theta,slam_vx,slam_omega,"
    "error95_m,state,map,epoch\n"
)
_FLUSH_S: Final = 1.0
_RETRY_S: Final = 60.0


class PairFile:
    """Appends lines; a full file becomes the older one. A disk that fails is told once a minute
    and never stops anything. Not for more than one thread."""

    def __init__(self, path: Path, most_bytes: int) -> None:
        self._path, self._most_bytes = path, most_bytes
        self._stream: TextIO | None = None
        self._written = 0
        self._flushed_s = 0.0
        self._retry_s = 0.0

    def write(self, line: str) -> None:
        """One line without its end."""
        now_s = time.monotonic()
        if now_s < self._retry_s:
            return
        try:
            if self._stream is None:
                self._stream = self._opened()
            self._stream.write(f"{line}\n")
            self._written += len(line) + 1
            if now_s - self._flushed_s > _FLUSH_S:
                self._stream.flush()
                self._flushed_s = now_s
            if self._written >= self._most_bytes:
                self._roll()
        except OSError as error:
            self._retry_s = now_s + _RETRY_S
            _log.warning("%s: cannot be written: %s", self._path, error.strerror or error)
            self._drop()

    def close(self) -> None:
        try:
            if self._stream is not None:
                self._stream.close()
        except OSError as error:
            _log.warning("%s: cannot be written: %s", self._path, error.strerror or error)
        self._stream = None

    def _opened(self) -> TextIO:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        if self._path.exists() and not self._continues():
            self._path.replace(self._older)
        stream = self._path.open("a", encoding="ascii", newline="\n")
        self._written = stream.tell()
        if not self._written:
            stream.write(HEADER)
            self._written = len(HEADER)
        return stream

    def _continues(self) -> bool:
        """Whether the file is one of ours, whole to its last line, and has room."""
        size = self._path.stat().st_size
        with self._path.open("rb") as stream:
            begins = stream.read(len(HEADER)) == HEADER.encode()
            stream.seek(max(size - 1, 0))
            return begins and stream.read(1) == b"\n" and size < self._most_bytes

    def _roll(self) -> None:
        self.close()
        self._path.replace(self._older)

    def _drop(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            try:
                stream.close()
            except OSError:
                return  # told already

    @property
    def _older(self) -> Path:
        return self._path.with_name(f"{self._path.stem}.1{self._path.suffix}")
