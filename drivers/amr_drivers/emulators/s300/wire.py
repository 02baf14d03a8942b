"""Bytes that leave as fast as the baud rate lets them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from amr_drivers.emulators.line import Line

_CHUNK = 62
"""Bytes that an FTDI adapter delivers at a time."""
_CHUNK_S = 0.005
"""It does not wait for longer to fill them."""
_LOOK_S = 0.001
"""How often requests are looked for."""
_IDLE_S = 0.1
"""How often whether it is over."""


class Wire:
    """A scanner's transmitter: one telegram at a time, from a thread of its own.

    ``answers``: what to send for bytes that the host has sent; called in that thread. None: the
    host is not listened to.
    """

    def __init__(
        self, line: Line, baud_rate: int, answers: Callable[[bytes], list[bytes]] | None
    ) -> None:
        self._line = line
        self._baud_rate = baud_rate
        self._answers = answers
        self._news = threading.Condition()
        self._next: bytes | None = None
        self._busy = False
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="s300-wire", daemon=True)
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        """True while a telegram is on its way."""
        with self._news:
            return self._busy or self._next is not None

    def offer(self, data: bytes) -> bool:
        """Begin to send, unless a telegram is still on its way: then this one is never sent."""
        with self._news:
            if self._busy or self._next is not None:
                return False
            self._next = data
            self._news.notify()
            return True

    def close(self) -> None:
        """Idempotent; a telegram on its way is cut."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.is_set():
            with self._news:
                if self._next is None:
                    self._news.wait(_IDLE_S if self._answers is None else _LOOK_S)
                data, self._next = self._next, None
                self._busy = data is not None
            if data is not None:
                self._send(data)
                with self._news:
                    self._busy = False
            if self._answers is not None:
                for answer in self._answers(self._line.read()):
                    self._send(answer)

    def _send(self, data: bytes) -> None:
        start_ns = time.monotonic_ns()
        chunk_bytes = max(1, min(_CHUNK, round(_CHUNK_S * self._baud_rate / 10)))
        for begin in range(0, len(data), chunk_bytes):
            chunk = data[begin : begin + chunk_bytes]
            self._line.write(chunk)
            # Against the start, not the last chunk: delays must not add up.
            due_ns = start_ns + (begin + len(chunk)) * 10_000_000_000 // self._baud_rate
            if self._stopping.wait(max(0, due_ns - time.monotonic_ns()) * 1e-9):
                return
