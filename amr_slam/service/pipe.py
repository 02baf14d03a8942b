"""The pipe to the SLAM process: what goes through it, and the two threads that wait at it."""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection

from amr_slam.slam_messages import Ready, Refused, Saved, SlamJob, Stop, Task, TaskAnswer, Unsaved
from amr_slam.slam_request import SlamRequest, SlamResult

Outgoing = SlamJob | SlamRequest | Task | Unsaved | Stop | None
"""None ends the sending thread."""
Sent = Ready | Refused | Saved | SlamResult | TaskAnswer


@dataclass(frozen=True, slots=True, kw_only=True)
class FromWorker:
    """What a process sent; None when its pipe has ended."""

    generation: int
    message: Sent | None


def send(pipe: Connection, outbox: queue.SimpleQueue[Outgoing]) -> None:
    """A thread: waits where a full pipe makes one wait."""
    while (request := outbox.get()) is not None:
        try:
            pipe.send(request)
        except OSError:
            return  # told by the receiving end


def receive(pipe: Connection, sink: Callable[[FromWorker], object], generation: int) -> None:
    """A thread: all that the process sends, then its end."""
    message: Sent | None
    while True:
        try:
            message = pipe.recv()
        except (EOFError, OSError):
            sink(FromWorker(generation=generation, message=None))
            return
        sink(FromWorker(generation=generation, message=message))
