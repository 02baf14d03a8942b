"""The SLAM engine as a process of its own: requests in at one end of a pipe, answers out.

Runs what is slow or may crash away from the poses. It ignores SIGINT and SIGTERM (its starter
blocks them): it ends when it is told to, or when the pipe says that its parent is gone, and in
both cases saves the map that it grew. The pipe's pickles come from our own parent, nobody else.
"""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from amr_slam.engine import Mode, SlamEngine
from amr_slam.map import MapError, PointMap, load_map, save_map
from amr_slam.params import SlamParams
from amr_slam.warming import warm_up

_NICENESS = 5
"""The poses' process goes first where processors are few."""
_OLD_VERSIONS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamJob:
    """What the process is to do."""

    mode: Mode
    params: SlamParams
    source: Path | None
    """The map to start with; None: an empty one."""
    target: Path | None
    """Mapping: where the map is saved."""
    name: str
    """Mapping: the map's name."""
    save_period_s: float
    """Mapping: a map that changed is saved this often."""
    saved_before: bool = False
    """The file at ``target`` is this run's own, not an older map that is worth keeping."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """The map is there; requests are answered from now on."""

    map_id: str | None
    """UUID of the file's content; None for a map that begins empty."""
    map_name: str
    map_scans: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """There is no map to work with; the process ends."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Saved:
    """The map was written, or was not."""

    map_scans: int
    error: str | None


class Stop:
    """Asks the process to save and to end."""


def serve(pipe: Connection, job: SlamJob) -> None:
    """Answer each SlamRequest by a SlamResult until Stop or the parent's end.

    The first message is Ready or Refused; Saved may come at any time.
    """
    with contextlib.suppress(PermissionError):  # a sandbox may forbid it
        os.nice(_NICENESS)
    try:
        grown, map_id = _open_map(job)
    except MapError as error:
        pipe.send(Refused(reason=str(error)))
        return
    warm_up(job.params)
    engine = SlamEngine(job.params, grown, job.mode)
    keeper = _Keeper(job, grown)
    try:
        pipe.send(Ready(map_id=map_id, map_name=grown.name, map_scans=len(grown.path)))
        while True:
            if pipe.poll(keeper.due_s()):
                request = pipe.recv()
                if isinstance(request, Stop):
                    break
                pipe.send(engine.update(request))
            if keeper.due_s() == 0.0:
                pipe.send(keeper.save())
    except (EOFError, ConnectionError):
        keeper.save_if_changed()  # the parent is gone: nobody to answer, but a map to keep
        return
    saved = keeper.save_if_changed()
    if saved is not None:
        with contextlib.suppress(ConnectionError):
            pipe.send(saved)


def _open_map(job: SlamJob) -> tuple[PointMap, str | None]:
    if job.source is None:
        return PointMap(job.params.map, job.name), None
    grown, map_id = load_map(job.source)
    return grown, str(map_id)


class _Keeper:
    """Knows when the map is to be saved, and saves it."""

    def __init__(self, job: SlamJob, grown: PointMap) -> None:
        self._target = job.target
        self._grown = grown
        self._saved_revision = grown.revision
        self._period_s = job.save_period_s
        self._next_s = time.monotonic() + job.save_period_s
        # Each save of one run replaces the last; older versions are those of earlier runs.
        self._keep = 0 if job.saved_before else _OLD_VERSIONS

    def due_s(self) -> float | None:
        """Seconds until the next save is due; None while there is nothing to save."""
        if self._target is None or self._grown.revision == self._saved_revision:
            return None
        return max(0.0, self._next_s - time.monotonic())

    def save(self) -> Saved:
        """Write the map; a full disk is reported and tried again a period later."""
        assert self._target is not None
        error = None
        try:
            save_map(self._grown, self._target, keep=self._keep)
            self._saved_revision = self._grown.revision
            self._keep = 0
        except MapError as reason:
            error = str(reason)
        self._next_s = time.monotonic() + self._period_s
        return Saved(map_scans=len(self._grown.path), error=error)

    def save_if_changed(self) -> Saved | None:
        return self.save() if self.due_s() is not None else None
