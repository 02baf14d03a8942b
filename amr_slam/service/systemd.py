"""What systemd is told: READY, STATUS, STOPPING, and the watchdog's food."""

from __future__ import annotations

import os
import time

import sdnotify


class Notifier:
    """Silent where nobody supervises; never waits."""

    def __init__(self) -> None:
        self._socket = sdnotify.SystemdNotifier()
        if self._socket.socket is not None:
            self._socket.socket.setblocking(False)  # a supervisor that hangs is not waited for
        self._period_ns = _watchdog_period_ns()
        self._fed_ns = 0

    def ready(self, status: str) -> None:
        self._socket.notify(f"READY=1\nSTATUS={status}")

    def status(self, status: str) -> None:
        self._socket.notify(f"STATUS={status}")

    def stopping(self) -> None:
        self._socket.notify("STOPPING=1\nSTATUS=stopping")

    def feed(self) -> None:
        """To be called after each completed turn; feeds four times in the watchdog's period."""
        now_ns = time.monotonic_ns()
        if self._period_ns is not None and now_ns - self._fed_ns >= self._period_ns // 4:
            self._fed_ns = now_ns
            self._socket.notify("WATCHDOG=1")


def _watchdog_period_ns() -> int | None:
    """None where no watchdog waits for this process."""
    period_us = os.environ.get("WATCHDOG_USEC", "")
    if not period_us.isdecimal() or os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(
        os.getpid()
    ):
        return None
    return 1000 * int(period_us)
