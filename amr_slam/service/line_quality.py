"""What a device's line tells by its bytes and counts, whichever driver reads it."""

from __future__ import annotations

import threading
from collections import deque
from typing import Final

_WINDOW_NS: Final = 10_000_000_000
_BAD_SHARE: Final = 0.05
_LEAST_TELEGRAMS: Final = 20
"""Of fewer in the window one bad one says nothing."""
_NO_SYNC_BYTES: Final = 65_536
_NO_SYNC_NS: Final = 1_000_000_000
_FEW_BYTES: Final = 4_096
"""The longest telegrams of slow lines take longer than a second to arrive."""


class LineQuality:
    """Damaged telegrams among good ones, and bytes in which no sample is found.

    Of one connection: :meth:`restart` when it is opened. ``bytes_came`` is for the driver's
    thread, the rest for the device's.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.restart()

    def restart(self) -> None:
        self._counts: deque[tuple[int, int, int]] = deque()
        """(ns, samples, errors) so far, the oldest at most a window ago."""
        self._samples = 0
        with self._lock:
            self._bytes, self._first_ns = 0, 0

    def bytes_came(self, count: int, stamp_ns: int) -> None:
        with self._lock:
            if self._bytes == 0:
                self._first_ns = stamp_ns
            self._bytes += count

    def sample_came(self) -> None:
        self._samples += 1
        with self._lock:
            self._bytes = 0

    def complaint(self, now_ns: int, errors: int) -> str | None:
        """What is wrong with the line now. ``errors``: telegrams that were damaged so far."""
        self._counts.append((now_ns, self._samples, errors))
        while now_ns - self._counts[0][0] > _WINDOW_NS:
            self._counts.popleft()
        with self._lock:
            unread, since_ns = self._bytes, now_ns - self._first_ns
        if unread >= _NO_SYNC_BYTES or (unread >= _FEW_BYTES and since_ns >= _NO_SYNC_NS):
            return (
                f"{unread / 1024.0:.0f} kB received and nothing of use in it: "
                "noise, baud rate, or another device?"
            )
        _, samples, before = self._counts[0]
        good, bad = self._samples - samples, errors - before
        if good + bad >= _LEAST_TELEGRAMS and bad > _BAD_SHARE * (good + bad):
            return f"{bad} of {good + bad} telegrams damaged in {1e-9 * _WINDOW_NS:g} s"
        return None
