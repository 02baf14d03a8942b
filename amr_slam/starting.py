"""The SLAM process's first moments. Imports next to nothing, so that a program can start it before
its own imports: both then do theirs side by side.

The process inherits blocked signals and never lifts that: no instant in which Ctrl-C, or a SIGTERM
to the whole group, could take the map with it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Final

_NICENESS: Final = 5
"""Where processors are few, the poses' process goes first, and before it what the daemon has to say
of its configuration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamProcess:
    """A process that waits for its SlamJob at the other end of the pipe, or has got it."""

    process: SpawnProcess
    pipe: Connection

    def end(self) -> None:
        """Whatever it does."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


class Started:
    """A process that was started for somebody who is to take it."""

    def __init__(self, slam: SlamProcess) -> None:
        self.slam: SlamProcess | None = slam

    def take(self) -> SlamProcess:
        """It is the taker's alone from now on, with its descriptors. Once."""
        slam, self.slam = self.slam, None
        assert slam is not None
        return slam


def start() -> SlamProcess:
    """A process whose pipe ends when it does."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    # A daemon: should it hang, the program ends all the same.
    process = context.Process(target=_serve, args=(theirs,), name="slam", daemon=True)
    # The tracker that multiprocessing starts with its first child would lift the mask too early, so
    # it is started before; SIGUSR1, which means the parent alone, is kept from both.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})
    try:
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    theirs.close()  # with the last copy in the child, its end is the pipe's end
    return SlamProcess(process=process, pipe=ours)


@contextmanager
def started() -> Iterator[Started]:
    """One that is gone at the end, if nobody has taken it."""
    waiting = Started(start())
    try:
        yield waiting
    finally:
        if waiting.slam is not None:
            waiting.slam.end()


def _serve(pipe: Connection) -> None:
    with suppress(PermissionError):  # a sandbox may forbid it
        os.nice(_NICENESS)
    # They take a second, meanwhile the parent goes on.
    from amr_slam import compiled  # noqa: PLC0415
    from amr_slam.slam_process import serve  # noqa: PLC0415

    compiled.load()
    try:
        job = pipe.recv()
    except (EOFError, ConnectionError):
        return  # the parent had nothing to do, or is gone
    serve(pipe, job)
