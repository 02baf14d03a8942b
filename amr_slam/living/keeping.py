"""Keeps what is watched on the disk: loaded with the map, written now and then and at the end."""

from __future__ import annotations

import logging
import time
import uuid
from pathlib import Path

from amr_slam.living.accepting import Accepted, accept, eligible
from amr_slam.living.file import changes_path, resume_watching, save_changes
from amr_slam.living.params import AcceptPolicy, WatchParams
from amr_slam.map import PointMap

_log = logging.getLogger(__name__)


class ChangeKeeper:
    """The watcher of one map that is localized in, and its file."""

    def __init__(self, known: PointMap, map_id: uuid.UUID, path: Path, params: WatchParams) -> None:
        """``path``: the map's file."""
        self._known, self._map_id = known, map_id
        self._path = changes_path(path)
        self._period_s = params.save_period_s
        self.watcher = resume_watching(self._path, known, map_id, params)
        self._saved_scans = self.watcher.scans
        self._next_s = time.monotonic() + self._period_s

    def due_s(self) -> float | None:
        """Seconds until the next saving is due; None while there is nothing to save."""
        if self.watcher.scans == self._saved_scans:
            return None
        return max(0.0, self._next_s - time.monotonic())

    def save(self) -> None:
        """A disk that cannot be written is tried again a period later."""
        self._next_s = time.monotonic() + self._period_s
        if self.watcher.scans == self._saved_scans:
            return
        try:
            save_changes(self.watcher, self._known, self._map_id, self._path)
        except OSError as error:
            _log.warning("changes: %s cannot be written: %s", self._path, error.strerror or error)
            return
        self._saved_scans = self.watcher.scans

    def accepted(self, policy: AcceptPolicy) -> Accepted | None:
        """A version of the map with what the policy accepts; None where that is nothing."""
        chosen = eligible(self.watcher.diff(), policy)
        done = accept(self._known, self.watcher, chosen) if chosen else None
        return done if done is not None and done.taken else None
