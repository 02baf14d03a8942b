"""Starts the programs of this package, and ends them whatever happens."""

from __future__ import annotations

import json
import selectors
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

_PATIENCE_S: Final = 240.0  # processors may be busy
_BUSY: Final = "while True: pass"


class Program:
    """One of them, under way. :meth:`end` gives its last word."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self._name = " ".join(map(str, process.args)) if isinstance(process.args, list) else ""
        self._read = selectors.DefaultSelector()
        assert process.stdout is not None
        self._read.register(process.stdout, selectors.EVENT_READ)

    @property
    def pid(self) -> int:
        return self.process.pid

    def line(self, timeout_s: float = _PATIENCE_S) -> str:
        """Its next line. Raises RuntimeError when none comes."""
        assert self.process.stdout is not None
        if not self._read.select(timeout_s):
            raise RuntimeError(f"{self._name}: silent")
        text = self.process.stdout.readline()
        if not text:
            raise RuntimeError(f"{self._name}: ended")
        return text

    def ask(self) -> dict[str, Any]:
        """Of a controller: what it has seen since the last time; a new measurement begins."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        told: dict[str, Any] = json.loads(self.line())
        return told

    def stop(self) -> None:
        """End its standard input, and wait for its end."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(_PATIENCE_S)

    def end(self) -> dict[str, Any]:
        """The same; returns what it says last."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        told: dict[str, Any] = json.loads(self.line())
        self.process.wait(_PATIENCE_S)
        return told

    def close(self) -> None:
        """Kill it if it is still there."""
        self._read.close()
        self.process.kill()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            stream.close()
        self.process.wait()


@contextmanager
def program(name: str, *arguments: str) -> Iterator[Program]:
    """``router``, ``robots`` or ``controller``, once it has said that it is ready."""
    process = subprocess.Popen(
        [sys.executable, "-m", f"amr_slam.studies.fleet.{name}", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
    )
    started = Program(process)
    try:
        started.line()
        yield started
    finally:
        started.close()


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that want a whole processor each."""
    processes = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def wait_until(controller: Program, robots: int, timeout_s: float = _PATIENCE_S) -> None:
    """Until a controller has heard of so many robots. Raises TimeoutError."""
    deadline_s = time.monotonic() + timeout_s
    while controller.ask()["heard"] < robots:
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"not all of {robots} robots were heard within {timeout_s:g} s")
        time.sleep(0.2)
