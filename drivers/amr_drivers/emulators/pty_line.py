"""A pseudo-terminal that stands in for a serial port, with a stable path and a plug to pull."""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from pathlib import Path


class PtyLine:
    """The device's end of a serial line.

    ``link`` is a path for a symbolic link to the port, which stays the same when the line is
    unplugged and plugged in again, as /dev/serial/by-id does. Writes never block: what nobody
    reads is lost once the kernel's buffer is full, as on a real line.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self._lock = threading.Lock()
        self._ends: tuple[int, int] | None = None
        self._path = ""
        self.plug()

    @property
    def port(self) -> str:
        """The path that a driver opens."""
        return str(self._link) if self._link is not None else self._path

    def plug(self) -> None:
        """Bring the port (back) into being. Without effect while it exists."""
        with self._lock:
            if self._ends is not None:
                return
            device, host = os.openpty()
            tty.setraw(host)
            os.set_blocking(device, False)
            # Held open: between two openings by a driver the line would otherwise hang up.
            self._ends = device, host
            self._path = os.ttyname(host)
            if self._link is not None:
                fresh = self._link.with_name(f".{self._link.name}.{os.getpid()}")
                fresh.unlink(missing_ok=True)
                fresh.symlink_to(self._path)
                fresh.replace(self._link)

    def unplug(self) -> None:
        """Hang up and remove the port. Idempotent."""
        with self._lock:
            if self._ends is None:
                return
            if self._link is not None:
                self._link.unlink(missing_ok=True)
            for end in self._ends:
                os.close(end)
            self._ends = None

    def write(self, data: bytes) -> int:
        """Send; how many bytes the line took: fewer when it is full, 0 when it is unplugged."""
        with self._lock:
            if self._ends is None:
                return 0
            sent = 0
            with contextlib.suppress(BlockingIOError):
                while sent < len(data):
                    sent += os.write(self._ends[0], data[sent:])
            return sent

    def read(self) -> bytes:
        """What the host has sent, without waiting; ``b""`` when there is nothing."""
        with self._lock:
            if self._ends is not None:
                with contextlib.suppress(BlockingIOError):
                    return os.read(self._ends[0], 4096)
            return b""
