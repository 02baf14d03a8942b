"""Serial ports, and serial ports behind a converter on the network."""

from __future__ import annotations

import contextlib
import socket
import termios
import threading
import time

import serial
from serial import SerialException

from amr_drivers.errors import LinkLost, LinkTimeout

_SLICE_S = 0.1
"""Longest single wait: what ``close`` from another thread may have to wait for."""
_BLOCK = 4096
_GONE = (OSError, termios.error)
"""What a port that is gone raises: the terminal's own error is no OSError."""
_KERNEL_BYTES = 1 << 15
"""What the kernel keeps of a connection's bytes while nobody reads: some telegrams of a serial
device, as a serial port does, not minutes of them."""


class ByteStream:
    """One open port, read by one thread; ``close`` may come from any other.

    ``port`` is a device path or a pyserial URL: ``/dev/serial/by-id/...``, ``socket://host:port``
    (raw TCP converter), ``rfc2217://host:port`` (converter that sets the baud rate itself).
    8 data bits, no parity, 1 stop bit, no flow control.

    Raises LinkLost when the port cannot be opened, LinkTimeout when a converter does not answer.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        self._port_name = port
        self._reading = threading.Lock()
        self._closed = threading.Event()
        self._is_rfc2217 = port.startswith("rfc2217://")
        try:
            # The lock on the port is advisory, but it stops a second copy of this program from
            # stealing every other byte.
            self._port = serial.serial_for_url(
                port,
                baudrate=baud_rate,
                timeout=_SLICE_S,
                # pyserial's RFC 2217 port refuses to be given a time limit for writing.
                write_timeout=None if self._is_rfc2217 else 1.0,
                exclusive=True,
            )
        except ValueError as error:
            raise ValueError(f"{port}: {error}") from error
        except _GONE as error:  # SerialException is one of them
            if isinstance(error.__context__, TimeoutError):
                raise LinkTimeout(f"{port}: {error}") from error
            raise LinkLost(f"{port}: {error}") from error
        self._connection: socket.socket | None = getattr(self._port, "_socket", None)
        if self._connection is not None:
            self._connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _KERNEL_BYTES)
        # On a socket `in_waiting` tells only whether there is anything: it cannot size a read.
        self._counts_waiting = not port.startswith("socket://")

    def read(self, timeout_s: float) -> bytes:
        """What arrived, as soon as anything did; ``b""`` when nothing came in time.

        The time-out is rounded up to 0.1 s, so that the first byte's arrival is not missed by a
        port that is set up anew for every call. Raises LinkLost on a hang-up or after ``close``.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            data = self._read_slice()
            if data or time.monotonic() >= deadline:
                return data

    def write(self, data: bytes) -> None:
        """Send all of it; a line that takes nothing for 1 s is lost. Raises LinkLost.

        Waits for a read in another thread, 0.1 s at most.
        """
        with self._reading:
            self._refuse_closed()
            try:
                self._port.write(data)
            except _GONE as error:  # pyserial's time-out for writing is one of them
                raise LinkLost(f"{self._port_name}: {error}") from error

    def discard_input(self) -> None:
        """Throw away all bytes that wait to be read. Raises LinkLost."""
        with self._reading:
            self._refuse_closed()
            try:
                if self._is_rfc2217:
                    # Asking the converter to purge would wait for its answer, 3 s at worst.
                    self._port.read(self._port.in_waiting)
                else:
                    self._port.reset_input_buffer()
            except _GONE as error:
                raise LinkLost(f"{self._port_name}: {error}") from error

    def close(self) -> None:
        """Idempotent; a read in another thread ends with LinkLost within 0.5 s."""
        self._closed.set()
        with self._reading, contextlib.suppress(*_GONE):
            # pyserial forgets to close a connection that the other end has cut.
            self._port.close()
            if self._connection is not None:
                self._connection.close()

    def _refuse_closed(self) -> None:
        if self._closed.is_set():
            raise LinkLost(f"{self._port_name}: closed")

    def _read_slice(self) -> bytes:
        with self._reading:
            self._refuse_closed()
            try:
                if self._counts_waiting:
                    return bytes(self._port.read(max(1, min(self._port.in_waiting, _BLOCK))))
                return self._read_socket()
            # pyserial lets the operating system's errors (EIO, ENODEV) through in places, and its
            # socket reader meets a concurrent hang-up as a TypeError.
            except (SerialException, OSError, TypeError) as error:
                raise LinkLost(f"{self._port_name}: {error}") from error

    def _read_socket(self) -> bytes:
        first = bytes(self._port.read(1))
        if not first:
            return first
        self._port.timeout = 0
        try:
            return first + bytes(self._port.read(_BLOCK))
        finally:
            self._port.timeout = _SLICE_S
