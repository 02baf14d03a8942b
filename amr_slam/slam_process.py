"""The SLAM engine as a process of its own: requests in at one end of a pipe, answers out.

Runs what is slow or may crash away from the poses. It ignores SIGINT and SIGTERM (its starter
blocks them): it ends when it is told to, or when the pipe says that its parent is gone, and in
both cases saves the map that it grew. The pipe's pickles come from our own parent, nobody else.
"""

from __future__ import annotations

import contextlib
import copy
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from amr_slam.engine import SlamEngine
from amr_slam.living import ChangeKeeper
from amr_slam.map import LoadedMap, MapError, PointMap, load_map, load_newest, save_map
from amr_slam.map.export import image_within, png_bytes
from amr_slam.map.lineage import frame_of
from amr_slam.slam_messages import (
    Compare,
    Compared,
    Declined,
    Draw,
    Drawn,
    Grow,
    Ready,
    Refused,
    Renewed,
    Saved,
    SlamJob,
    Stop,
    Store,
    Stored,
    Switch,
    Switched,
    Task,
    TaskAnswer,
    Unsaved,
)
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.warming import warm_up

_log = logging.getLogger(__name__)

_OLD_VERSIONS = 2
_MAX_PIXELS: Final = 4_000_000
"""Of a picture: a few hundred kilobytes as PNG, half a second to make."""


def serve(pipe: Connection, job: SlamJob) -> None:
    """Answer each SlamRequest by a SlamResult, and each task, until Stop or the parent's end.

    The first message is Ready or Refused; Saved may come at any time.
    """
    try:
        server = _Server(job)
    except MapError as error:
        pipe.send(Refused(reason=str(error)))
        return
    warm_up(job.params)
    try:
        pipe.send(server.ready())
        _loop(pipe, server)
    except (EOFError, ConnectionError):
        server.save()  # the parent is gone: nobody to answer, a map to keep
        return
    saved = server.save()
    if saved is not None:
        with contextlib.suppress(ConnectionError):
            pipe.send(saved)


def _loop(pipe: Connection, server: _Server) -> None:
    while True:
        if pipe.poll(server.due_s()):
            request = pipe.recv()
            if isinstance(request, Stop):
                return
            if isinstance(request, Unsaved):
                server.join(request)
                continue
            pipe.send(server.answer(request))
        if server.keeper.due_s() == 0.0:
            pipe.send(server.keeper.save())
        renewed = server.look_after_changes()
        if renewed is not None:
            pipe.send(renewed)


class _Server:
    """One job's engine and map; :class:`Switch` replaces both."""

    _engine: SlamEngine
    _changes: ChangeKeeper | None
    """What is watched of the map, if anything is."""

    def __init__(self, job: SlamJob) -> None:
        """Raises MapError."""
        self._adopt(job, _load(job))

    def ready(self) -> Ready:
        grown, loaded = self._engine.map, self._loaded
        return Ready(
            map_id=None if loaded is None else str(loaded.map_id),
            map_name=grown.name,
            map_scans=len(grown.path),
            path=None if loaded is None else loaded.path,
            complaint=None if loaded is None else loaded.complaint,
        )

    def due_s(self) -> float | None:
        """Seconds until something is to be done by itself; None for never."""
        due = (self.keeper.due_s(), None if self._changes is None else self._changes.due_s())
        return min((one for one in due if one is not None), default=None)

    def save(self) -> Saved | None:
        """All that would be lost; what became of the map, where that had changed."""
        if self._changes is not None:
            self._changes.save()
        return self.keeper.save_if_changed()

    def look_after_changes(self) -> Renewed | None:
        """Where it is time to: write what was watched, and accept what the policy says."""
        changes, loaded = self._changes, self._loaded
        if changes is None or loaded is None or changes.due_s() != 0.0:
            return None
        changes.save()
        done = changes.accepted(self._job.policy)
        if done is None or loaded.complaint is not None:
            return None
        try:
            if load_map(loaded.path)[1] != loaded.map_id:
                _log.warning("changes are not accepted: %s is newer, load_map it", loaded.path)
                return None
            map_id = save_map(done.map, loaded.path, keep=self._job.policy.keep)
        except MapError as error:
            _log.warning("changes are not accepted: %s", error)
            return None
        self._adopt(self._job, replace(loaded, map=done.map, map_id=map_id))
        return Renewed(ready=self.ready(), taken=len(done.taken))

    def answer(self, request: SlamRequest | Task) -> SlamResult | TaskAnswer:
        try:
            match request:
                case SlamRequest():
                    self._engine.utc_from_stamp_ns = time.time_ns() - time.monotonic_ns()
                    result = self._engine.update(request)
                    if result.moved is not None:
                        # What joined before lies elsewhere now: only the file can tell a new
                        # process where.
                        self.keeper.hurry()
                    return result
                case Switch():
                    return self._switch(request.job)
                case Grow():
                    return self._grow(request.job)
                case Store():
                    return self._store(request)
                case Draw() | Compare():
                    return self._tell(request)
        except MapError as error:
            return Declined(reason=str(error))

    def join(self, unsaved: Unsaved) -> None:
        for one in unsaved.scans:
            self._engine.join(one.cloud, one.map_from_base, one.covariance)

    def _switch(self, job: SlamJob) -> Switched:
        if job.target is not None:
            _must_be_free(job.target)
        loaded = _load(job)
        saved = self.save()
        if saved is not None and saved.error is not None:
            raise MapError(saved.error)
        same_frame = loaded is not None and self._shares_frame(job, loaded.map)
        self._adopt(job, loaded)
        return Switched(job=job, ready=self.ready(), same_frame=same_frame)

    def _shares_frame(self, job: SlamJob, known: PointMap) -> bool:
        frame = frame_of(known)
        both = self._job.mode == job.mode == "localization"
        return both and frame != "" and frame == frame_of(self._engine.map)

    def _grow(self, job: SlamJob) -> Switched:
        self.save()
        self._changes = self._engine.watcher = None
        self._job = job
        self._engine.go_on(hold=job.hold)
        self.keeper = _Keeper(job, self._engine.map, self._engine.settle)
        return Switched(job=job, ready=self.ready())

    def _adopt(self, job: SlamJob, loaded: LoadedMap | None) -> None:
        grown = PointMap(job.params.map, job.name) if loaded is None else loaded.map
        self._job, self._loaded = job, loaded
        # A process that was lost is no reason to give up the loops of its map.
        resumed = job.saved_before and job.source == job.target
        self._engine = SlamEngine(job.params, grown, job.mode, resumed=resumed)
        self.keeper = _Keeper(job, grown, self._engine.settle)
        self._changes = self._watched(job, loaded)
        if self._changes is not None:
            self._engine.watcher = self._changes.watcher
        if job.hold and job.mode == "mapping":
            self._engine.hold()

    @staticmethod
    def _watched(job: SlamJob, loaded: LoadedMap | None) -> ChangeKeeper | None:
        watches = job.mode == "localization" and job.params.watching.watch
        if not watches or loaded is None or job.source is None:
            return None
        return ChangeKeeper(loaded.map, loaded.map_id, job.source, job.params.watching)

    def _store(self, task: Store) -> Stored:
        grown = self._engine.map
        if not len(grown):
            raise MapError("there is nothing in the map yet")
        if task.target is None or task.target == self._job.target:
            path, map_id = self.keeper.store()
        else:
            _must_be_free(task.target)
            self._engine.settle()
            path, copied = task.target, copy.copy(grown)
            copied.name = task.name or grown.name
            map_id = str(save_map(copied, path, keep=0))
        return Stored(path=path, map_id=map_id, map_scans=len(grown.path))

    def _tell(self, task: Draw | Compare) -> Drawn | Compared | Declined:
        if isinstance(task, Draw):
            return self._draw(task)
        if self._changes is None:
            return Declined(reason="no changes are watched: it is mapping, or slam.watching is off")
        return Compared(diff=self._changes.watcher.diff())

    def _draw(self, task: Draw) -> Drawn:
        self._engine.settle()
        image = image_within(self._engine.map, task.resolution_m, _MAX_PIXELS)
        rows, columns = image.pixels.shape
        return Drawn(
            png=png_bytes(image),
            columns=columns,
            rows=rows,
            resolution_m=image.resolution_m,
            x_min_m=image.x_min_m,
            y_min_m=image.y_min_m,
            map_scans=len(self._engine.map.path),
        )


def _load(job: SlamJob) -> LoadedMap | None:
    """None: the job's map begins empty. Raises MapError."""
    return None if job.source is None else load_newest(job.source)


def _must_be_free(path: Path) -> None:
    if path.exists():
        raise MapError(f"there is a map named {path.stem} already: choose another name")


class _Keeper:
    """Knows when the map is to be saved, and saves it."""

    def __init__(self, job: SlamJob, grown: PointMap, settle: Callable[[], None]) -> None:
        """``settle`` brings ``grown`` up to date."""
        self._target = job.target
        self._grown = grown
        self._settle = settle
        self._saved_revision = grown.revision
        self._saved_id: str | None = None
        self._period_s = job.save_period_s
        self._saved_s = time.monotonic()
        self._next_s = self._saved_s + job.save_period_s
        # Each save of one run replaces the last; older versions are those of earlier runs.
        self._keep = 0 if job.saved_before else _OLD_VERSIONS

    def due_s(self) -> float | None:
        """Seconds until the next save is due; None while there is nothing to save."""
        if self._target is None or self._grown.revision == self._saved_revision:
            return None
        return max(0.0, self._next_s - time.monotonic())

    def hurry(self) -> None:
        """Save as soon as nobody waits, but no more often than each tenth of the period."""
        soon_s = self._saved_s + 0.1 * self._period_s
        self._next_s = min(self._next_s, max(soon_s, time.monotonic()))

    def save(self) -> Saved:
        """Write the map; a full disk is reported and tried again a period later."""
        error = None
        try:
            self.store()
        except MapError as reason:
            error = str(reason)
        self._saved_s = time.monotonic()
        self._next_s = self._saved_s + self._period_s
        return Saved(map_scans=len(self._grown.path), error=error)

    def save_if_changed(self) -> Saved | None:
        return self.save() if self.due_s() is not None else None

    def store(self) -> tuple[Path, str]:
        """The file and the UUID of the map as it is now, written if it was not. Raises MapError."""
        if self._target is None:
            raise MapError("a map that is not being made has its file already")
        self._settle()
        if self._saved_id is None or self._grown.revision != self._saved_revision:
            self._saved_id = str(save_map(self._grown, self._target, keep=self._keep))
            self._saved_revision = self._grown.revision
            self._keep = 0
        return self._target, self._saved_id
