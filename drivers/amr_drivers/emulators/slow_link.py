"""A link of so many bits a second between two TCP endpoints, as a wireless network is one."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from typing import Final, Self

_CHUNK: Final = 4096
_BUFFER: Final = 16 * 1024
"""Of the relay's sockets: a real link holds little, too; what waits, waits at the sender."""


class SlowLink:
    """Listens on loopback and passes on what comes, in both directions, at ``bits_per_s`` each.

    A context manager. ``endpoint``: where to connect to instead.
    """

    def __init__(self, endpoint: str, bits_per_s: float) -> None:
        host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
        self._to = host, int(port)
        self._s_per_byte = 8.0 / bits_per_s
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        self._sockets: list[socket.socket] = [self._listening]
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self._listening.getsockname()[1]}"

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:  # closed
                return
            far = socket.socket()
            far.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
            far.connect(self._to)
            self._sockets += [near, far]
            for pair in ((near, far), (far, near)):
                thread = threading.Thread(target=self._pass_on, args=pair, daemon=True)
                self._threads.append(thread)
                thread.start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        free_s = time.monotonic()
        with suppress(OSError):  # either side has gone
            while data := source.recv(_CHUNK):
                free_s = max(free_s, time.monotonic()) + len(data) * self._s_per_byte
                time.sleep(max(0.0, free_s - time.monotonic()))
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        for one in self._sockets:
            with suppress(OSError):  # not connected
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        for thread in self._threads:
            thread.join()
