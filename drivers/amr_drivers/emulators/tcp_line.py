"""A TCP port that stands in for a serial line behind a converter, with a plug to pull."""

from __future__ import annotations

import contextlib
import socket
import threading


class TcpLine:
    """The device's end: one host at a time, the newest wins. Writes never block.

    Raises OSError when the port is taken.
    """

    def __init__(self, tcp_port: int = 0) -> None:
        """``tcp_port`` on the loopback interface; 0: any that is free, the same ever after."""
        self._lock = threading.Lock()
        self._server: socket.socket | None = None
        self._host: socket.socket | None = None
        self._tcp_port = tcp_port
        self.plug()

    @property
    def port(self) -> str:
        """The URL that a driver opens."""
        return f"socket://127.0.0.1:{self._tcp_port}"

    def plug(self) -> None:
        """Listen (again). Without effect while it does."""
        with self._lock:
            if self._server is None:
                self._server = socket.create_server(("127.0.0.1", self._tcp_port))
                self._server.setblocking(False)
                self._tcp_port = self._server.getsockname()[1]

    def unplug(self) -> None:
        """Cut the connection and refuse new ones. Idempotent."""
        with self._lock:
            for end in (self._host, self._server):
                if end is not None:
                    end.close()
            self._host = self._server = None

    def write(self, data: bytes) -> int:
        """Send; how many bytes the line took: fewer when it is full, 0 when nobody is there."""
        with self._lock:
            self._accept()
            if self._host is None:
                return 0
            try:
                return self._host.send(data)
            except BlockingIOError:
                return 0
            except OSError:
                self._hang_up()
                return 0

    def read(self) -> bytes:
        """What the host has sent, without waiting; ``b""`` when there is nothing."""
        with self._lock:
            self._accept()
            if self._host is None:
                return b""
            try:
                data = self._host.recv(4096)
            except BlockingIOError:
                return b""
            except OSError:
                data = b""
            if not data:
                self._hang_up()
            return data

    def _accept(self) -> None:
        if self._server is None:
            return
        with contextlib.suppress(BlockingIOError):
            host, _ = self._server.accept()
            self._hang_up()
            self._host = host
            host.setblocking(False)
            host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _hang_up(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None
