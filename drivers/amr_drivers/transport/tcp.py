"""A TCP connection to a device."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time

from amr_drivers.errors import LinkLost, LinkTimeout

_SLICE_S = 0.1
"""Longest single wait: what ``close`` from another thread may have to wait for."""
_BLOCK = 65536
_MAX_DISCARDED = 16 * 1024 * 1024
"""What throwing away may read at most: a peer that sends faster than this reads never ends."""


class TcpStream:
    """One open connection, read by one thread; ``close`` may come from any other.

    Raises LinkLost when nobody listens there or the name is unknown, LinkTimeout when no answer
    comes within ``connect_timeout_s``.
    """

    def __init__(self, host: str, port: int, connect_timeout_s: float = 2.0) -> None:
        self._name = f"{host}:{port}"
        self._reading = threading.Lock()
        self._closed = threading.Event()
        try:
            self._socket = socket.create_connection((host, port), connect_timeout_s)
        except TimeoutError as error:
            raise LinkTimeout(f"{self._name}: no answer in {connect_timeout_s:g} s") from error
        except OSError as error:
            raise LinkLost(f"{self._name}: {error.strerror or error}") from error
        # Requests are single small segments: waiting to join them only makes stamps late.
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(1.0)

    @property
    def own_host(self) -> str:
        """Address of this machine as the device sees it. Raises LinkLost after ``close``."""
        try:
            return str(self._socket.getsockname()[0])
        except OSError as error:
            raise LinkLost(f"{self._name}: {error.strerror or error}") from error

    def read(self, timeout_s: float) -> bytes:
        """What arrived, as soon as anything did; ``b""`` when nothing came in time.

        Raises LinkLost on a hang-up or after ``close``.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            left_s = deadline - time.monotonic()
            if data := self._read_slice(min(max(left_s, 0.0), _SLICE_S)):
                return data
            if left_s <= _SLICE_S:
                return b""

    def write(self, data: bytes) -> None:
        """Send all of it; a peer that takes nothing for 1 s is lost. Raises LinkLost."""
        with self._reading:
            self._refuse_closed()
            try:
                self._socket.sendall(data)
            except OSError as error:
                raise LinkLost(f"{self._name}: {error.strerror or error}") from error

    def discard_input(self) -> None:
        """Throw away all bytes that wait to be read. Raises LinkLost."""
        discarded = 0
        while discarded < _MAX_DISCARDED and (data := self._read_slice(0.0)):
            discarded += len(data)

    def close(self) -> None:
        """Idempotent; a read in another thread ends with LinkLost within 0.5 s."""
        self._closed.set()
        with self._reading, contextlib.suppress(OSError):
            self._socket.close()

    def _refuse_closed(self) -> None:
        if self._closed.is_set():
            raise LinkLost(f"{self._name}: closed")

    def _read_slice(self, timeout_s: float) -> bytes:
        with self._reading:
            self._refuse_closed()
            try:
                if not select.select([self._socket], [], [], timeout_s)[0]:
                    return b""
                data = self._socket.recv(_BLOCK)
            except OSError as error:
                raise LinkLost(f"{self._name}: {error.strerror or error}") from error
        if not data:
            raise LinkLost(f"{self._name}: the device has hung up")
        return data
