"""A TCP server for devices: connections that are accepted, fed, cut and refused at will."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from collections.abc import Callable

from amr_drivers.sick_cola.framing import ColaAReader, ColaBReader, Dialect, FrameReader

_SLICE_S = 0.02
_QUEUE = 262_144
"""Bytes that a device keeps for a reader who does not read; what comes then is lost as a whole."""
_KERNEL_BYTES = 65_536


class Connection:
    """One client. ``send`` never waits; any thread."""

    def __init__(self, client: socket.socket) -> None:
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BYTES)
        self._client = client
        self._queue = bytearray()
        self._lock = threading.Lock()
        self.readers: dict[Dialect, FrameReader] = {
            Dialect.A: ColaAReader(),
            Dialect.B: ColaBReader(),
        }
        self.mute = False
        """The wrong dialect was heard: nothing is answered any more."""
        self.subscribed = False

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


class DeviceServer:
    """Listens on one address, with one thread for all connections."""

    def __init__(
        self,
        host: str,
        port: int,
        connected: Callable[[Connection], None],
        heard: Callable[[Connection, bytes], None],
    ) -> None:
        """``connected`` and ``heard`` are called by the server's thread. Raises OSError."""
        self._connected = connected
        self._heard = heard
        self._lock = threading.Lock()
        self._connections: list[Connection] = []
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

    def connections(self) -> list[Connection]:
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

    def cut(self, connection: Connection) -> None:
        """Hang up on one client."""
        with self._lock:
            if connection in self._connections:
                self._connections.remove(connection)
        connection.close()

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
            connection = Connection(client)
            self._connections.append(connection)
        self._connected(connection)

    def _read(self, connection: Connection) -> None:
        data = connection.receive()
        if data is None:
            self.cut(connection)
        elif data:
            self._heard(connection, data)
