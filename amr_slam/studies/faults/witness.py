"""The fleet's side: all that a robot has published, with the instant at which it came in."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

from amr_slam.client import FleetListener
from amr_slam.judging import ReportedPose
from amr_slam.service.clocks import WallClock
from amr_slam.states import State
from amr_slam.trial import reported
from amr_slam.wire import PoseMessage, StatusMessage

_WAIT_S: Final = 0.02
CLOCK_STEP_S: Final = 3600.0
"""Clocks are set by an hour here: what is left of an age is the age."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Presence:
    """The robot's ``alive`` token was seen, or fell."""

    alive: bool
    state: State | None = None
    fault: str | None = None


Message = PoseMessage | StatusMessage | Presence
Says = Callable[[Message], bool]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heard:
    """One message."""

    received_ns: int
    """``time.monotonic_ns()``."""
    message: Message
    report: ReportedPose | None = None
    """Of a pose: the same on the monotonic clock."""


class Witness:
    """Listens to one robot, over restarts of its daemon. A context manager."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._heard: list[Heard] = []
        self._news = threading.Condition()
        self._listener: FleetListener | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def follow(self, listener: FleetListener) -> None:
        """Record what comes through this one from now on; it is closed in the end."""
        self._hang_up()
        self._listener = listener
        self._thread = threading.Thread(target=self._record, args=(listener,), daemon=True)
        self._thread.start()

    @property
    def listener(self) -> FleetListener:
        """The present one. Raises RuntimeError before :meth:`follow`."""
        if self._listener is None:
            raise RuntimeError("nobody is followed yet")
        return self._listener

    @property
    def refused(self) -> int:
        """Payloads that were no messages, on the present listener."""
        return self.listener.views()[self._robot].refused

    def since(self, begin_ns: int) -> list[Heard]:
        """What came in from ``begin_ns`` on."""
        with self._news:
            return [heard for heard in self._heard if heard.received_ns >= begin_ns]

    def first(self, says: Says, since_ns: int) -> Heard | None:
        """The first of these that says so."""
        return first(says, self.since(since_ns))

    def wait_for(self, says: Says, since_ns: int, timeout_s: float) -> Heard | None:
        """The same; waits for it until ``timeout_s`` from now."""
        deadline_s = time.monotonic() + timeout_s
        looked = 0
        with self._news:
            while True:
                for heard in self._heard[looked:]:
                    if heard.received_ns >= since_ns and says(heard.message):
                        return heard
                looked = len(self._heard)
                left_s = deadline_s - time.monotonic()
                if left_s <= 0.0:
                    return None
                self._news.wait(left_s)

    def close(self) -> None:
        """Idempotent."""
        self._hang_up()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _hang_up(self) -> None:
        if self._thread is not None and self._listener is not None:
            self._stopping.set()
            self._thread.join()
            self._stopping.clear()
            self._listener.close()
            self._thread = None

    def _record(self, listener: FleetListener) -> None:
        status: StatusMessage | None = None
        alive = False
        # Once: both clocks run alike, and a busy computer may come between two readings.
        utc_from_monotonic_ns = WallClock().utc_from_monotonic_ns
        while not self._stopping.is_set():
            pose = listener.next_pose(_WAIT_S)
            now_ns = time.monotonic_ns()
            view = listener.views()[self._robot]
            news: list[Heard] = []
            if pose is not None:
                report = _this_hour(reported(pose, now_ns + utc_from_monotonic_ns, now_ns))
                news.append(Heard(received_ns=now_ns, message=pose, report=report))
            if view.status is not None and view.status is not status:
                status = view.status
                news.append(Heard(received_ns=now_ns, message=status))
            if view.alive != alive:
                alive = view.alive
                news.append(Heard(received_ns=now_ns, message=Presence(alive=alive)))
            if news:
                with self._news:
                    self._heard += news
                    self._news.notify_all()


def first(says: Says, heard: Sequence[Heard]) -> Heard | None:
    """The first that says so."""
    return next((one for one in heard if says(one.message)), None)


def _this_hour(report: ReportedPose) -> ReportedPose:
    age_s = math.remainder(1e-9 * (report.received_ns - report.stamp_ns), CLOCK_STEP_S)
    return replace(report, stamp_ns=report.received_ns - round(1e9 * age_s))
