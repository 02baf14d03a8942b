"""A serial-to-Ethernet converter on this machine: raw TCP, or RFC 2217."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
from collections.abc import Callable
from typing import Literal

from serial.rfc2217 import PortManager

_WAIT_S = 0.02
_BLOCK = 4096
_BUFFER = 1 << 14
"""Bytes that wait in a converter for a host that does not take them."""
_MAX_KEPT = 4096
"""Bytes from the host that are kept for a device that does not look at them."""
_AT_ONCE = struct.pack("ii", 1, 0)
"""SO_LINGER: closing drops what is not sent yet and resets the connection."""


class EmulatedConverter:
    """A :class:`amr_drivers.emulators.line.Line` behind a TCP port. The newest connection counts:
    an older one is dropped. Writes never block.

    ``kind`` "rfc2217": the host sets the baud rate, too; :attr:`baud_rate` tells.
    """

    def __init__(
        self, kind: Literal["socket", "rfc2217"], host: str = "127.0.0.1", port: int = 0
    ) -> None:
        """Port 0 lets the system choose. Raises OSError when it cannot be listened on."""
        self._kind = kind
        self._address = host, port
        self._lock = threading.RLock()
        self._client: _Client | None = None
        self._kept = bytearray()
        self._settings = _SerialPort()
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self.plug()

    @property
    def port(self) -> str:
        return f"{self._kind}://{self._address[0]}:{self._address[1]}"

    @property
    def baud_rate(self) -> int:
        """What the host has set by RFC 2217."""
        return self._settings.baudrate

    @property
    def is_connected(self) -> bool:
        """Whether a host is connected, as far as it is known."""
        return self._client is not None

    def plug(self) -> None:
        """Listen (again). Without effect while it does."""
        if self._thread is not None:
            return
        listener = socket.create_server(self._address)
        self._address = listener.getsockname()[:2]
        self._stopping.clear()
        self._thread = threading.Thread(
            target=self._serve, args=(listener,), name="converter", daemon=True
        )
        self._thread.start()

    def unplug(self) -> None:
        """Cut the connection and refuse new ones. Idempotent."""
        if self._thread is None:
            return
        self._stopping.set()
        self._thread.join()
        self._thread = None

    def hang_up(self) -> None:
        """Cut the connection; the host may come again."""
        with self._lock:
            if self._client is not None:
                self._client.close()
                self._client = None

    def write(self, data: bytes) -> int:
        with self._lock:
            return 0 if self._client is None else self._client.write(data)

    def read(self) -> bytes:
        with self._lock:
            data = bytes(self._kept)
            self._kept.clear()
            return data

    def _serve(self, listener: socket.socket) -> None:
        with listener:
            while not self._stopping.is_set():
                client = self._client
                watched = [listener] if client is None else [listener, client.socket]
                # A client that is closed meanwhile has no number any more.
                with contextlib.suppress(ValueError, OSError):
                    ready = select.select(watched, [], [], _WAIT_S)[0]
                    if listener in ready:
                        self._accept(listener.accept()[0])
                    elif ready and client is not None:
                        self._receive(client)
        self.hang_up()

    def _accept(self, connection: socket.socket) -> None:
        self.hang_up()
        with self._lock:
            self._client = _Client(connection, self._settings if self._kind == "rfc2217" else None)

    def _receive(self, client: _Client) -> None:
        with self._lock:
            if client is not self._client:
                return
            data = client.read()
            if data is None:
                self.hang_up()
            else:
                self._kept += data
                del self._kept[:-_MAX_KEPT]


class _Client:
    """One connection; ``settings`` given: it speaks RFC 2217."""

    def __init__(self, connection: socket.socket, settings: _SerialPort | None) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        self.socket = connection
        self._manager = None if settings is None else PortManager(settings, _Writer(self._send))

    def read(self) -> bytes | None:
        """What came, without the Telnet commands; None when the host has hung up."""
        try:
            data = self.socket.recv(_BLOCK)
        except OSError:
            return None
        if not data:
            return None
        return data if self._manager is None else b"".join(self._manager.filter(data))

    def write(self, data: bytes) -> int:
        """How many bytes were taken; what does not fit is lost."""
        if self._manager is None:
            return self._send(data)
        # A piece of an escape sequence must not be lost: all or nothing.
        escaped = b"".join(self._manager.escape(data))
        return len(data) if self._send(escaped) == len(escaped) else 0

    def close(self) -> None:
        self.socket.close()

    def _send(self, data: bytes) -> int:
        try:
            return self.socket.send(data)
        except OSError:
            return 0


class _Writer:
    """What pyserial's PortManager calls a connection."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self.write = write


class _SerialPort:
    """The settings of the converter's serial port, as pyserial's PortManager wants to find them.
    Its modem lines are those of a wire of three cores."""

    def __init__(self) -> None:
        self.baudrate = 9600
        self.bytesize = 8
        self.parity = "N"
        self.stopbits = 1
        self.xonxoff = self.rtscts = False
        self.dtr = self.rts = self.break_condition = False
        self.cts = self.dsr = self.ri = self.cd = False

    def reset_input_buffer(self) -> None:
        """Nothing waits in it."""

    def reset_output_buffer(self) -> None:
        """Nothing waits in it."""
