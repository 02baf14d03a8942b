"""What is to be done in the SLAM process beside scans: in turn with them, one at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from amr_slam.service.worker import SlamWorker
from amr_slam.serving import Asked
from amr_slam.slam_messages import Declined, Task, TaskAnswer

Done = Callable[[TaskAnswer], object]


class Tasks:
    """A queue before the process. All methods are for the loop's thread and return at once.

    The queue is as short as the desks that ask are narrow.
    """

    def __init__(self, worker: SlamWorker) -> None:
        self._worker = worker
        self._waiting: deque[tuple[Asked, Task, Done]] = deque()
        self._running: tuple[Asked, Done] | None = None
        self._first = True

    @property
    def first(self) -> bool:
        """Whether a task goes before a scan: they take turns."""
        return self._first and bool(self._waiting)

    def add(self, asked: Asked, task: Task, done: Done) -> None:
        """``done`` gets what the process answers, unless that is Declined: then ``asked`` does,
        as it does when the process ends."""
        self._waiting.append((asked, task, done))

    def yield_turn(self) -> None:
        """A scan has been handed out."""
        self._first = True

    def submit(self) -> None:
        """Hand out the next one, if there is one and the process is idle."""
        while self._waiting and self._worker.idle:
            asked, task, done = self._waiting.popleft()
            if asked.answer.cancelled():
                continue
            self._running = asked, done
            self._first = False
            self._worker.submit(task)

    def heard(self, answer: TaskAnswer) -> None:
        """The process has answered the running one."""
        assert self._running is not None
        (asked, done), self._running = self._running, None
        if isinstance(answer, Declined):
            asked.not_done(answer.reason)
        else:
            done(answer)

    def lost(self) -> None:
        """The process has ended: what ran in it is lost, what waits goes on waiting."""
        if self._running is not None:
            self._running[0].not_done("the SLAM process has ended meanwhile")
            self._running = None
