"""Commands in other forms, on keys that are published on: no reply goes back."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from functools import partial
from typing import Final

import zenoh

from amr_slam.encodings import Inlet, Request
from amr_slam.serving.commands import BURST, RATE_HZ, perform
from amr_slam.serving.desk import Allowance, Answering, Desk
from amr_slam.wire import CommandReply, WireError

_log = logging.getLogger(__name__)

_LOG_RATE_HZ: Final = 0.2
_LOG_BURST: Final = 5
"""Lines about what was refused: a sender of junk must not fill the log."""


class InletDesk:
    """Listens on the inlets of encoders; what comes in is one command at a time."""

    def __init__(self, session: zenoh.Session, inlets: Sequence[Inlet], desk: Desk) -> None:
        """``desk``: with one place, and for all that commands; whoever made it closes it."""
        self._desk = desk
        now_s = time.monotonic()
        self._allowance = Allowance(RATE_HZ, BURST, now_s)
        self._lines = Allowance(_LOG_RATE_HZ, _LOG_BURST, now_s)
        self._lock = threading.Lock()
        self._refused = 0
        self._subscribers = [
            session.declare_subscriber(inlet.key, partial(self._on_sample, inlet))
            for inlet in inlets
        ]

    @property
    def refused(self) -> int:
        """How many payloads were not taken."""
        with self._lock:
            return self._refused

    def _on_sample(self, inlet: Inlet, sample: zenoh.Sample) -> None:
        """On a thread of zenoh's."""
        try:
            request = self._read(inlet, sample)
        except WireError as error:
            self._refuse(inlet, None, str(error))
            return
        if request is None:
            return
        with self._lock:
            allowed = self._allowance.takes(time.monotonic())
        if not allowed:
            self._refuse(inlet, request, f"too many commands: {RATE_HZ:g} a second is enough")
        elif not self._desk.enter(lambda: self._perform(inlet, request)):
            self._refuse(inlet, request, "another command is under way")

    @staticmethod
    def _read(inlet: Inlet, sample: zenoh.Sample) -> Request | None:
        if sample.kind != zenoh.SampleKind.PUT:
            raise WireError("deletes nothing: there is nothing to delete")
        if len(sample.payload) > inlet.max_bytes:
            raise WireError(f"{len(sample.payload)} bytes, at most {inlet.max_bytes}")
        return inlet.decode(sample.payload.to_bytes())

    def _perform(self, inlet: Inlet, request: Request) -> Answering:
        """On the desk's thread."""
        reply = perform(self._desk, request.command, inlet.name)
        if not reply.ok:
            with self._lock:
                self._refused += 1
        return lambda: _tell(request, reply)

    def _refuse(self, inlet: Inlet, request: Request | None, reason: str) -> None:
        with self._lock:
            self._refused += 1
            is_logged = self._lines.takes(time.monotonic())
        if is_logged:
            _log.warning("%s: refused: %s", inlet.name, reason)
        if request is not None:
            _tell(request, CommandReply.refusing(reason))


def _tell(request: Request, reply: CommandReply) -> None:
    if request.answered is not None:
        request.answered(reply)
