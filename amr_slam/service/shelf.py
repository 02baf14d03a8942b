"""The folder of the recordings that nobody asked for: bounded, the oldest goes first."""

from __future__ import annotations

import logging
from pathlib import Path

_log = logging.getLogger(__name__)


class Shelf:
    """Only files that the daemon has put there by itself are in it. For one thread at a time."""

    def __init__(self, folder: Path, max_bytes: int, max_count: int) -> None:
        self.folder = folder
        self._max_bytes = max_bytes
        self._max_count = max_count

    def make_room(self, size_bytes: int) -> bool:
        """For one more recording of this size; whether there can be any. Raises OSError."""
        if size_bytes > self._max_bytes:
            return False
        self._bound(self._max_bytes - size_bytes, self._max_count - 1)
        return True

    def trim(self) -> None:
        """Once it is there, and has turned out larger. Raises OSError."""
        self._bound(self._max_bytes, self._max_count)

    def _bound(self, most_bytes: int, most: int) -> None:
        kept = self._recordings()
        while kept and (len(kept) > most or sum(size for _, size in kept) > most_bytes):
            self._drop(kept.pop(0)[0])

    def drop_oldest(self) -> bool:
        """Whether there was one. Raises OSError."""
        kept = self._recordings()
        if kept:
            self._drop(kept[0][0])
        return bool(kept)

    def _recordings(self) -> list[tuple[Path, int]]:
        """Files and their sizes, the oldest first: names begin with robot and UTC."""
        return [(path, path.stat().st_size) for path in sorted(self.folder.glob("*.mcap"))]

    def _drop(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        _log.info("%s: deleted to make room", path)
