"""A CoLa 2 session: one TCP connection, one question at a time."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Final, Self

from amr_drivers.errors import BadTelegram, DriverError, LinkLost, LinkTimeout
from amr_drivers.sick_safety.cola2 import (
    Command,
    Frame,
    FrameReader,
    call_method,
    close_session,
    encode_frame,
    error_code,
    error_text,
    open_session,
    read_variable,
)
from amr_drivers.sick_safety.decoder import answers
from amr_drivers.transport import TcpStream

_SLICE_S: Final = 0.05
_GOODBYE_S: Final = 0.1
"""How long the answer to the close of a session is waited for."""
_STALE_READS: Final = 16
"""A peer that sends without pause would never end the look at what lies here."""
_REQUESTS: Final = 2**16


class Refused(DriverError):  # noqa: N818 - says what happened
    """The scanner answers, and says no."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


def _unheard(_data: bytes, _stamp_ns: int) -> None:
    """For who records nothing."""


def _unsent(_data: bytes) -> None:
    """For who records nothing."""


class Session:
    """Questions to a scanner over a stream that is open; used by one thread.

    ``name``: what the other end is called in complaints.
    ``heard`` and ``sent`` are given all bytes as they come and go. ``stopping`` ends a wait.
    """

    def __init__(
        self,
        name: str,
        stream: TcpStream,
        *,
        answer_s: float,
        stopping: threading.Event,
        heard: Callable[[bytes, int], None] = _unheard,
        sent: Callable[[bytes], None] = _unsent,
    ) -> None:
        self._name = name
        self._stream = stream
        self._answer_s = answer_s
        self._stopping = stopping
        self._heard = heard
        self._sent = sent
        self._reader = FrameReader()
        self._request = 0
        self._session: int | None = None

    def open(self, idle_s: int) -> Self:
        """Get a session that the scanner ends when nothing is asked for ``idle_s`` (1..255).

        Raises Refused: no session left; LinkTimeout, BadTelegram: nobody who speaks CoLa 2.
        """
        self._session = None
        self._session = self._ask(open_session(self._next(), idle_s), self._answer_s).session
        return self

    def read(self, index: int) -> bytes:
        """A variable's value. Raises Refused."""
        return self._ask(read_variable(self._id(), self._next(), index), self._answer_s).data

    def call(self, index: int, data: bytes) -> bytes:
        """A method's result. Raises Refused."""
        return self._ask(call_method(self._id(), self._next(), index, data), self._answer_s).data

    def close(self) -> None:
        """Give the session back: there are few. Idempotent; the stream stays open."""
        if self._session is None:
            return
        question = close_session(self._session, self._next())
        self._session = None
        with contextlib.suppress(DriverError):
            self._ask(question, _GOODBYE_S, stoppable=False)

    def _id(self) -> int:
        if self._session is None:
            raise LinkLost(f"{self._name}: no session is open")
        return self._session

    def _next(self) -> int:
        self._request = self._request % (_REQUESTS - 1) + 1
        return self._request

    def _ask(self, question: Frame, limit_s: float, *, stoppable: bool = True) -> Frame:
        # What lies here already is no answer; left in place it could hide the one to come.
        for _ in range(_STALE_READS):
            if not (stale := self._stream.read(0.0)):
                break
            self._heard(stale, time.monotonic_ns())
        self._reader.reset()
        data = encode_frame(question)
        self._stream.write(data)
        self._sent(data)
        deadline = time.monotonic() + limit_s
        noise = b""
        while True:
            left_s = deadline - time.monotonic()
            if stoppable and self._stopping.is_set():
                raise LinkLost(f"{self._name}: closed")
            if left_s <= 0.0:
                raise self._silence(noise, limit_s)
            data = self._stream.read(min(_SLICE_S, left_s))
            if not data:
                continue
            self._heard(data, time.monotonic_ns())
            noise = noise or data[:16]
            for frame in self._reader.feed(data):
                if answers(frame, question):
                    return self._accepted(frame)

    def _silence(self, noise: bytes, limit_s: float) -> DriverError:
        if noise:
            text = f"{self._name}: no answer in CoLa 2 but {noise!r}: is it another device?"
            return BadTelegram(text)
        return LinkTimeout(f"{self._name}: no answer in {limit_s:g} s")

    def _accepted(self, frame: Frame) -> Frame:
        if frame.command != Command.FAILED:
            return frame
        code = error_code(frame)
        raise Refused(f"{self._name}: the scanner refuses: {error_text(code)}", code)
