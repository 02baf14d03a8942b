"""What simulated and recorded devices share: a common source, and samples at their time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from amr_drivers.errors import LinkLost

_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


class Shared(Generic[_Key, _Value]):
    """One value a key for all who hold it: made for the first, forgotten after the last."""

    def __init__(self, make: Callable[[_Key], _Value]) -> None:
        self._make = make
        self._lock = threading.Lock()
        self._held: dict[_Key, tuple[_Value, int]] = {}

    def take(self, key: _Key) -> _Value:
        with self._lock:
            value, holders = self._held[key] if key in self._held else (self._make(key), 0)
            self._held[key] = value, holders + 1
            return value

    def give_back(self, key: _Key) -> None:
        with self._lock:
            value, holders = self._held.pop(key)
            if holders > 1:
                self._held[key] = value, holders - 1


class Hold(Generic[_Key, _Value]):
    """One device's hold on a shared value, and its waiting; ``close`` ends both."""

    def __init__(self, shared: Shared[_Key, _Value], key: _Key) -> None:
        self._shared, self._key = shared, key
        self._closed = threading.Event()
        self.value = shared.take(key)

    def wait_until(self, due_ns: int, deadline_ns: int) -> bool:
        """Wait for ``due_ns`` or ``deadline_ns`` (monotonic); True when the former has come.

        Raises LinkLost when this hold is or becomes closed.
        """
        while True:
            left_ns = min(due_ns, deadline_ns) - time.monotonic_ns()
            if self._closed.wait(max(0.0, left_ns * 1e-9)):
                raise LinkLost("closed")
            now_ns = time.monotonic_ns()
            if now_ns >= due_ns or now_ns >= deadline_ns:
                return now_ns >= due_ns

    def close(self) -> None:
        """Idempotent."""
        if not self._closed.is_set():
            self._closed.set()
            self._shared.give_back(self._key)


def deadline_ns(timeout_s: float) -> int:
    """The monotonic instant at which a time-out that begins now ends."""
    return time.monotonic_ns() + round(1e9 * timeout_s)
