"""How late this machine is: limits are for an idle one."""

from __future__ import annotations

import threading
import time
from collections import deque
from types import TracebackType
from typing import Final, Self

import numpy as np

_NAP_S: Final = 0.005


class Stalls:
    """A thread that naps, and notes by how much it overslept; a context manager.

    What a busy machine (or whoever holds Python's lock) does to this thread it does to the
    driver's, too: what was measured is judged with that much more patience.
    """

    def __init__(self) -> None:
        self._naps: deque[tuple[int, float]] = deque(maxlen=20_000)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="conformance-stalls", daemon=True)

    def worst_s(self, since_ns: int, until_ns: int | None = None) -> float:
        """The longest delay between two instants; None: until now."""
        return float(max(self._between(since_ns, until_ns), default=0.0))

    def median_s(self, since_ns: int) -> float:
        """The usual delay since then."""
        return float(np.median(self._between(since_ns, None) or [0.0]))

    def _between(self, since_ns: int, until_ns: int | None) -> list[float]:
        # A nap that began before the end of the time counts with all its delay.
        return [
            late_s
            for ended_ns, late_s in list(self._naps)
            if ended_ns >= since_ns
            and (until_ns is None or ended_ns - 1e9 * (late_s + _NAP_S) <= until_ns)
        ]

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while True:
            begun_ns = time.monotonic_ns()
            if self._stopping.wait(_NAP_S):
                return
            ended_ns = time.monotonic_ns()
            self._naps.append((ended_ns, max(0.0, 1e-9 * (ended_ns - begun_ns) - _NAP_S)))
