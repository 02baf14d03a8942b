"""A thread that puts messages, so that whoever makes them never waits for the network.

Zenoh drops what does not fit into a queue, but a put first waits for its turn in the queue of its
priority, and there a large answer may stand that somebody's slow link takes long to take.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Final

import zenoh

_CLOSE_S: Final = 0.3


class Sender:
    """Puts in order; of too many that wait, the oldest go."""

    def __init__(self, name: str, places: int) -> None:
        self._waiting: deque[Callable[[], object]] = deque(maxlen=places)
        self._wakes = threading.Event()
        self._closed = False
        self._failure: zenoh.ZError | None = None
        # A daemon: a network that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def send(self, put: Callable[[], object]) -> None:
        """Have ``put`` called. Returns at once. Raises ZError when an earlier one could not be
        put."""
        if self._thread.ident is None:
            self._thread.start()
        elif not self._thread.is_alive():
            raise self._failure or RuntimeError(f"{self._thread.name}: the thread has failed")
        self._waiting.append(put)
        self._wakes.set()

    def close(self) -> None:
        """Put what waits, for a moment at most. Idempotent."""
        self._closed = True
        self._wakes.set()
        if self._thread.ident is not None:
            self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        while not self._closed or self._waiting:
            self._wakes.wait()
            self._wakes.clear()
            try:
                while self._waiting:
                    self._waiting.popleft()()
            except zenoh.ZError as error:  # the session was closed over a put that hung, say
                self._failure = error
                return
