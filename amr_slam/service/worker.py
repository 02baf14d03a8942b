"""The SLAM process from its parent's side: one job at a time, a pulse, and a new one when it dies.

Nothing here waits for the process but :meth:`SlamWorker.stop`: one thread sends, another one
receives into the loop's queue. A message of a process that was given up is not heard any more.
"""

from __future__ import annotations

import itertools
import logging
import queue
import signal
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from amr_slam import starting
from amr_slam.living import ChangeCounts
from amr_slam.samples import Health, Link
from amr_slam.service.pipe import FromWorker, Outgoing, receive, send
from amr_slam.slam_messages import (
    Compared,
    Declined,
    Drawn,
    Joined,
    Ready,
    Refused,
    Renewed,
    Saved,
    SlamJob,
    Stop,
    Stored,
    Switched,
    Task,
    TaskAnswer,
    Unsaved,
)
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.starting import Started
from amr_slam.states import Mode

_log = logging.getLogger(__name__)

_START_LIMIT_NS: Final = 60_000_000_000
"""From the start to Ready: imports on a slow computer and a large map."""
_TASK_LIMIT_NS: Final = 60_000_000_000
"""For a task: to load, to write or to draw the largest map on a slow computer."""
_PULSE_GRACE_NS: Final = 2_000_000_000
"""A process that outlives its kill by this much hangs in the kernel: the pulse stops."""
_MOST_UNSAVED: Final = 1000
"""Scans that are kept for a map that cannot be saved: half an hour of driving, 50 MB."""
_END_S: Final = 0.2
"""What the kernel may take to end a process whose pipe has ended."""
_FIRST_RETRY_NS: Final = 500_000_000
_LAST_RETRY_NS: Final = 5_000_000_000
_REFUSED_RETRY_NS: Final = 15_000_000_000
"""Somebody has to bring another map."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActiveMap:
    """The map that poses refer to."""

    map_id: str
    """Localization: UUID of the file's content. Mapping: of this run's map, whose content still
    changes; its file has one of its own."""
    name: str
    scans: int
    """That it is made of."""
    path: Path | None = None
    """The file that it was loaded from."""


class SlamWorker:
    """The present process and what is known of it. All methods are for the loop's thread."""

    def __init__(
        self,
        job: SlamJob,
        sink: Callable[[FromWorker], object],
        answer_limit_s: float,
        started: Started | None = None,
    ) -> None:
        """``started``: the first process, where it was started already."""
        self._job = job
        self._sink = sink
        self._answer_limit_ns = round(1e9 * answer_limit_s)
        self._run_id = str(uuid.uuid4()) if job.mode == "mapping" else None
        self._generations = itertools.count(1)
        self._retry_ns = _FIRST_RETRY_NS
        self._restart_ns: int | None = None
        self._ready = False
        self._deadline_ns: int | None = None
        self._limit_ns = self._answer_limit_ns
        self._answered_ns: int | None = None
        self._answers = 0
        self._crashes = 0
        self._detail: str | None = "starting"
        self._killed_for: str | None = None
        self._stopping = False
        self.active_map: ActiveMap | None = None
        self.refusal: str | None = None
        """Why there is no process: its map cannot be used."""
        self.fault: str | None = None
        """What to tell with every pose until a fix shows that it is over."""
        self.warning: str | None = None
        """What to tell with every pose while it lasts: a map that cannot be saved, or an older
        version that stands in for a damaged one."""
        self.changes: ChangeCounts | None = None
        """What has been watched of the map's changes, as of the newest answer."""
        self._asked: SlamRequest | None = None
        # What a new process needs beside the file on disk to go on as if nothing had happened.
        self._unsaved: deque[Joined] = deque(maxlen=_MOST_UNSAVED)
        self._spawn(started)

    # -- for the loop ----------------------------------------------------------------------

    @property
    def idle(self) -> bool:
        """Whether a request or a task may be submitted."""
        return self._ready and self._deadline_ns is None

    @property
    def ready(self) -> bool:
        """Whether the process has its map."""
        return self._ready

    @property
    def pid(self) -> int | None:
        """Of the present process."""
        return self._process.pid

    @property
    def job(self) -> SlamJob:
        """What the process does, or a new one would begin with."""
        return self._job

    @property
    def mode(self) -> Mode:
        """Of the job."""
        return self._job.mode

    @property
    def crashes(self) -> int:
        """Processes that were lost so far."""
        return self._crashes

    def submit(self, request: SlamRequest | Task) -> None:
        """Hand over one request or task; only while idle."""
        self._asked = request if isinstance(request, SlamRequest) else None
        self._limit_ns = (
            self._answer_limit_ns if isinstance(request, SlamRequest) else _TASK_LIMIT_NS
        )
        self._deadline_ns = time.monotonic_ns() + self._limit_ns
        self._outbox.put(request)

    def hear(self, received: FromWorker) -> SlamResult | TaskAnswer | Renewed | None:
        """Take in what the process sent; the answer, if it was one, or that the map is another."""
        message = received.message
        if received.generation != self._generation:
            return None
        if self._stopping and not isinstance(message, Saved):
            return None
        match message:
            case Ready():
                self._on_ready(message)
            case Refused():
                self._on_refused(message)
            case Saved():
                self._on_saved(message)
            case SlamResult():
                self._on_answer(message)
                return message
            case Switched() | Stored() | Drawn() | Compared() | Declined():
                self._on_task_answer(message)
                return message
            case Renewed():
                self._on_map(message.ready)
                _log.info("slam: the map has taken in %d changes", message.taken)
                return message
            case None:
                self._on_death()
        return None

    def supervise(self, now_ns: int) -> None:
        """Kill a process that is overdue; start the next one when it is time to."""
        if self._restart_ns is not None and now_ns >= self._restart_ns:
            self._restart_ns = None
            self._spawn()
        overdue = self._deadline_ns is not None and now_ns > self._deadline_ns
        if overdue and self._killed_for is None:
            self._killed_for = (
                f"no answer within {1e-9 * self._limit_ns:g} s"
                if self._ready
                else f"not ready within {1e-9 * _START_LIMIT_NS:g} s"
            )
            self._complain(self._killed_for)
            self._process.kill()  # its pipe ends, and that is heard

    def has_pulse(self, now_ns: int) -> bool:
        """Whether the process answers, or is within its limit, or is being replaced."""
        return self._deadline_ns is None or now_ns <= self._deadline_ns + _PULSE_GRACE_NS

    def health(self, now_ns: int) -> Health:
        """Rate and samples are those of the answers."""
        if self._restart_ns is not None or self._killed_for is not None:
            link = Link.LOST
        else:
            link = Link.OK if self._ready else Link.STALE
        age_s = None
        if self._answered_ns is not None:
            age_s = max(0.0, 1e-9 * (now_ns - self._answered_ns))
        return Health(
            link=link,
            age_s=age_s,
            rate_hz=self._rate_hz if link is Link.OK else 0.0,
            samples=self._answers,
            errors=self._crashes,
            detail=self._detail,
        )

    def stop(self, timeout_s: float) -> None:
        """Let it save its map and end, or end it after ``timeout_s``."""
        self._stopping = True
        self._outbox.put(Stop())
        self._process.join(timeout_s)
        if self._process.is_alive():
            _log.warning("slam: busy for too long, ended without saving its last scans")
            self._process.kill()
            self._process.join(_END_S)
        self._outbox.put(None)
        self._receiver.join(_END_S)

    # -- what happened to it ---------------------------------------------------------------

    def _spawn(self, started: Started | None = None) -> None:
        slam = starting.start() if started is None else started.take()
        self._process, pipe = slam.process, slam.pipe
        self._generation = next(self._generations)
        self._ready = False
        self._killed_for = None
        self._rate_hz = 0.0
        self._deadline_ns = time.monotonic_ns() + _START_LIMIT_NS
        self._outbox: queue.SimpleQueue[Outgoing] = queue.SimpleQueue()
        self._outbox.put(self._job)
        if self._unsaved:
            self._outbox.put(Unsaved(scans=tuple(self._unsaved)))
        # Daemons: a process that hangs must not keep the program from ending.
        threading.Thread(target=send, args=(pipe, self._outbox), daemon=True).start()
        self._receiver = threading.Thread(
            target=receive, args=(pipe, self._sink, self._generation), daemon=True
        )
        self._receiver.start()

    def _on_ready(self, message: Ready) -> None:
        self._ready = True
        self._deadline_ns = None
        if self.refusal is not None:
            self.refusal, self._retry_ns = None, _FIRST_RETRY_NS
        if self._crashes == 0:
            self._detail = None
        else:
            self._complain(f"{self._detail}; {self._after_crash()}")
        self._on_map(message)
        _log.info("slam: ready, map %s of %d scans", message.map_name, message.map_scans)

    def _on_map(self, ready: Ready) -> None:
        map_id = self._run_id or ready.map_id
        if map_id is not None:
            self.active_map = ActiveMap(
                map_id=map_id, name=ready.map_name, scans=ready.map_scans, path=ready.path
            )
        self.warning = ready.complaint
        if ready.complaint is not None:
            _log.error("slam: %s", ready.complaint)

    def _on_task_answer(self, message: TaskAnswer) -> None:
        self._deadline_ns = None
        if isinstance(message, Switched):
            self._job = message.job
            self._run_id = str(uuid.uuid4()) if self.mode == "mapping" else None
            self._detail = self.fault = self.changes = None
            self._unsaved.clear()
            self._on_map(message.ready)
            _log.info("slam: %s, map %s", self.mode, message.ready.map_name)
        elif isinstance(message, Stored) and message.path == self._job.target:
            self._on_saved(Saved(map_scans=message.map_scans, error=None))

    def _after_crash(self) -> str:
        source, scans = self._job.source, len(self._unsaved)
        if source is not None and not scans:
            return f"started again with {source}"
        if source is None and not scans:
            return "started again with an empty map"
        saved = "" if source is None else f"{source} and "
        return f"started again with {saved}the {scans} scans since it was saved"

    def _on_refused(self, message: Refused) -> None:
        """There may be a map later: it is tried again as a process that was lost is."""
        self._killed_for = message.reason
        self.refusal = message.reason
        self._retry_ns = _REFUSED_RETRY_NS

    def _on_saved(self, message: Saved) -> None:
        if message.error is not None:
            self._detail, self.warning = message.error, f"slam: {message.error}"
            _log.warning("slam: %s", message.error)
            return
        self.warning = None
        if self._crashes == 0:
            self._detail = None
        # From now on this file is what a new process goes on with.
        self._job = replace(self._job, source=self._job.target, saved_before=True)
        self._unsaved.clear()
        _log.info("slam: map of %d scans saved to %s", message.map_scans, self._job.target)

    def _on_answer(self, message: SlamResult) -> None:
        now_ns = time.monotonic_ns()
        if self._answered_ns is not None:
            self._rate_hz = 1e9 / max(1, now_ns - self._answered_ns)
        self._answered_ns = now_ns
        self._deadline_ns = None
        self._answers += 1
        self.changes = message.changes
        self._retry_ns = _FIRST_RETRY_NS
        if message.joined_at is not None and self._asked is not None:
            pose, covariance = message.joined_at
            self._unsaved.append(
                Joined(cloud=self._asked.cloud, map_from_base=pose, covariance=covariance)
            )
        if message.fix is not None or message.inserted:
            self.fault = None
        if self.active_map is not None:
            self.active_map = replace(self.active_map, scans=message.map_scans)

    def _on_death(self) -> None:
        self._process.join(_END_S)
        self._process.kill()
        self._crashes += 1
        self._ready = False
        self._deadline_ns = None
        self._complain(self._killed_for or _told(self._process.exitcode))
        self._restart_ns = time.monotonic_ns() + self._retry_ns
        self._retry_ns = max(self._retry_ns, min(2 * self._retry_ns, _LAST_RETRY_NS))
        self._outbox.put(None)
        _log.error("slam: %s; a new process starts", self._detail)

    def _complain(self, reason: str) -> None:
        self._detail = reason
        self.fault = f"slam: {reason}"


def _told(exitcode: int | None) -> str:
    if exitcode is None:
        return "the pipe broke"
    if exitcode < 0:
        return f"killed by {signal.Signals(-exitcode).name}"
    return f"ended with exit status {exitcode}"
