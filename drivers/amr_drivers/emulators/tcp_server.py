"""A TCP server for devices: connections that are accepted, fed, cut and refused at will."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from collections.abc import Callable
from typing import Final, Generic, TypeVar

Held = TypeVar("Held")
"""What a device holds for each of its clients."""

_SLICE_S: Final = 0.02
_QUEUE: Final = 262_144
"""Bytes that a device keeps for a reader who does not read; what comes then is lost as a whole."""
_KERNEL_BYTES: Final = 65_536


class Connection(Generic[Held]):
    """One client. ``send`` never waits; any thread."""

    def __init__(self, client: socket.socket, held: Held) -> None:
        self.held = held
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BYTES)
        self._client = client
        self._queue = bytearray()
        self._lock = threading.Lock()

    def send(self, data: bytes) -> None:
        """Send now, or as soon as the client reads."""
        with self._lock:
            if len(self._queue) + len(data) <= _QUEUE or not self._queue:
                self._queue += data
            self._flush()

    def flush(self) -> None:
        """Send what waits."""
        with self._lock:
            self._flush()

    def receive(self) -> bytes | None:
        """What the client sent; None when it is gone."""
        try:
            return self._client.recv(4096) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def fileno(self) -> int:
        return self._client.fileno()

    def close(self) -> None:
        """Idempotent."""
        with self._lock:
            self._queue.clear()
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)
            self._client.close()

    def _flush(self) -> None:
        while self._queue:
            try:
                sent = self._client.send(self._queue)
            except BlockingIOError:
                return
            except OSError:
                self._queue.clear()
                return
            del self._queue[:sent]


class DeviceServer(Generic[Held]):
    """Listens on one address, with one thread for all connections."""

    def __init__(
        self,
        host: str,
        port: int,
        hold: Callable[[], Held],
        *,
        connected: Callable[[Connection[Held]], None],
        heard: Callable[[Connection[Held], bytes], None],
        gone: Callable[[Connection[Held]], None] | None = None,
    ) -> None:
        """``port`` 0 lets the system choose. ``hold`` makes what a new connection holds. All are
        called by the server's thread, ``gone`` by others, too. Raises OSError."""
        self._hold, self._connected, self._heard, self._gone = hold, connected, heard, gone
        self._lock = threading.Lock()
        self._connections: list[Connection[Held]] = []
        self._listener: socket.socket | None = None
        self._address = (host, port)
        self.plug()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"device-{port}", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens; stays the same after :meth:`unplug`."""
        return self._address[1]

    def connections(self) -> list[Connection[Held]]:
        """The clients of this moment."""
        with self._lock:
            return list(self._connections)

    def plug(self) -> None:
        """Accept connections. Idempotent."""
        with self._lock:
            if self._listener is None:
                listener = socket.create_server(self._address)
                listener.setblocking(False)
                self._address = (self._address[0], listener.getsockname()[1])
                self._listener = listener

    def unplug(self) -> None:
        """Cut all connections and refuse new ones. Idempotent."""
        with self._lock:
            if self._listener is not None:
                # A select in the other thread would keep a listener that is only closed alive.
                self._listener.shutdown(socket.SHUT_RDWR)
                self._listener.close()
                self._listener = None
        self.cut_all()

    def cut_all(self) -> None:
        """Cut all connections."""
        for connection in self.connections():
            self.cut(connection)

    def cut(self, connection: Connection[Held]) -> None:
        """Hang up on one client."""
        with self._lock:
            if connection not in self._connections:
                return
            self._connections.remove(connection)
        connection.close()
        if self._gone is not None:
            self._gone(connection)

    def close(self) -> None:
        """Idempotent."""
        self._stopping.set()
        self._thread.join()
        self.unplug()

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._accept()
            connections = {connection.fileno(): connection for connection in self.connections()}
            try:
                ready, _, _ = select.select([*connections, *self._listening()], [], [], _SLICE_S)
            except (OSError, ValueError):
                continue  # another thread has cut a connection meanwhile: it has no number any more
            for number, connection in connections.items():
                connection.flush()
                if number in ready:
                    self._read(connection)

    def _listening(self) -> list[int]:
        with self._lock:
            return [] if self._listener is None else [self._listener.fileno()]

    def _accept(self) -> None:
        with self._lock:
            if self._listener is None:
                return
            try:
                client, _ = self._listener.accept()
            except OSError:  # nobody has called
                return
            connection = Connection(client, self._hold())
            self._connections.append(connection)
        self._connected(connection)

    def _read(self, connection: Connection[Held]) -> None:
        data = connection.receive()
        if data is None:
            self.cut(connection)
        elif data:
            self._heard(connection, data)
