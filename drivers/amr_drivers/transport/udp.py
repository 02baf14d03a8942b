"""A UDP port on which a device's datagrams arrive."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time

from amr_drivers.errors import LinkLost

_SLICE_S = 0.1
"""Longest single wait: what ``close`` from another thread may have to wait for."""
_LARGEST = 65535
_KERNEL_BYTES = 1 << 20
"""What the kernel keeps while nobody reads: some scans of a device, not minutes of them."""
_MAX_DISCARDED = 65536
"""Datagrams that throwing away takes at most: a sender that never pauses would never end it."""


class DatagramPort:
    """One bound port, read by one thread; ``close`` may come from any other.

    ``port`` 0 lets the system choose; :attr:`port` tells. Datagrams of other senders than
    ``sender`` (an address, empty: anybody) are dropped. Raises LinkLost when the address is not
    this machine's or the port is taken.
    """

    def __init__(self, host: str, port: int, sender: str = "") -> None:
        self._name = f"udp {host}:{port}"
        self._reading = threading.Lock()
        self._closed = threading.Event()
        self._foreign = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._sender = socket.gethostbyname(sender) if sender else ""
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _KERNEL_BYTES)
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise LinkLost(f"{self._name}: {error.strerror or error}") from error
        self.port: int = self._socket.getsockname()[1]

    @property
    def foreign(self) -> int:
        """Datagrams that came from somebody else and were dropped."""
        return self._foreign

    def read(self, timeout_s: float) -> bytes:
        """The next datagram; ``b""`` when none came in time. Raises LinkLost after ``close``."""
        deadline = time.monotonic() + timeout_s
        while True:
            left_s = deadline - time.monotonic()
            if data := self._read_slice(min(max(left_s, 0.0), _SLICE_S)):
                return data
            if left_s <= _SLICE_S:
                return b""

    def discard_input(self) -> None:
        """Throw away all datagrams that wait to be read. Raises LinkLost."""
        for _ in range(_MAX_DISCARDED):
            if self._read_slice(0.0) is None:
                return

    def close(self) -> None:
        """Idempotent; a read in another thread ends with LinkLost within 0.5 s."""
        self._closed.set()
        with self._reading, contextlib.suppress(OSError):
            self._socket.close()

    def _read_slice(self, timeout_s: float) -> bytes | None:
        """None: nothing came. A datagram of a foreign sender counts as an empty one."""
        with self._reading:
            if self._closed.is_set():
                raise LinkLost(f"{self._name}: closed")
            try:
                if not select.select([self._socket], [], [], timeout_s)[0]:
                    return None
                data, (host, _) = self._socket.recvfrom(_LARGEST)
            except OSError as error:
                raise LinkLost(f"{self._name}: {error.strerror or error}") from error
        if self._sender and host != self._sender:
            self._foreign += 1
            return b""
        return data
