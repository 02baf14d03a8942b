"""A desk: one thread that asks the loop, one thing after another, and answers."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError
from typing import Any, Final

import zenoh

from amr_slam.serving.asked import Asked, NotDone, Put

_log = logging.getLogger(__name__)

ANSWER_LIMIT_S: Final = 45.0
"""Nothing that is asked is left without an answer for longer."""
_CLOSE_S: Final = 0.3
_MAX_BY: Final = 80

Answering = Callable[[], None]
"""Sends an answer."""
Work = Callable[[], Answering]
"""Does what is asked; what comes back sends the answer."""


class Desk:
    """One queue and one thread: asks the loop, one thing after another."""

    def __init__(self, name: str, put: Put, places: int) -> None:
        """``places``: queries that are here at once, the one in hand included."""
        self._put = put
        self._places = threading.Semaphore(places)
        self._queue: queue.SimpleQueue[Work | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._asked: Asked | None = None
        self._closed = False
        # A daemon: a network that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def enter(self, work: Work) -> bool:
        """Have the thread do it; False when there is no place left. Any thread."""
        if self._closed or not self._places.acquire(blocking=False):
            return False
        self._queue.put(work)
        return True

    def ask(self, asked: Asked) -> Any:
        """For the thread: what became of it. Raises NotDone, also where nobody answers in time."""
        with self._lock:
            if self._closed:
                raise NotDone("the robot's program is stopping")
            self._asked = asked
        self._put(asked)
        try:
            return asked.answer.result(ANSWER_LIMIT_S)
        except CancelledError:
            raise NotDone("the robot's program is stopping") from None
        except TimeoutError:
            asked.answer.cancel()
            reason = f"not done within {ANSWER_LIMIT_S:g} s; status tells whether it still happens"
            raise NotDone(reason) from None

    def close(self) -> None:
        """What is asked is given up."""
        with self._lock:
            self._closed = True
            if self._asked is not None:
                self._asked.answer.cancel()
        self._queue.put(None)
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        while (work := self._queue.get()) is not None:
            try:
                answer = work()
            finally:
                self._places.release()  # before the answer: who has it may ask again
            try:
                answer()
            except zenoh.ZError as error:  # the session closes, or who asked has gone
                _log.warning("an answer could not be sent: %s", " ".join(str(error).split())[:200])


class Allowance:
    """So many at once, and so many a second then."""

    def __init__(self, rate_hz: float, burst: int, now_s: float) -> None:
        self._rate_hz, self._burst = rate_hz, burst
        self._left, self._looked_s = float(burst), now_s

    def takes(self, now_s: float) -> bool:
        """Whether one more is within it; then it is counted."""
        grown = self._left + self._rate_hz * (now_s - self._looked_s)
        self._left, self._looked_s = min(grown, float(self._burst)), now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


def asking(query: zenoh.Query) -> str:
    """Who asks: zenoh tells no more than the session, and that only where the asking side adds it.
    With access control, the router's log names certificates."""
    source = query.source_info
    return "somebody" if source is None else f"session {source.source_id.zid}"[:_MAX_BY]
