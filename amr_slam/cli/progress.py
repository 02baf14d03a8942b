"""How far a long command has come, where somebody is looking."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self

PERIOD_S = 0.2


class OneLine:
    """A line on standard error that is written over, and gone at the end."""

    def __init__(self, *, shown: bool) -> None:
        self._shown = shown

    def __enter__(self) -> Self:
        return self

    def _write(self, text: str) -> None:
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._shown:
            self._write("")


class Progress(OneLine):
    """One line on standard error that is written over; nothing where that is no terminal."""

    def __init__(self, what: str, start_ns: int, end_ns: int, *, quiet: bool = False) -> None:
        """``start_ns`` and ``end_ns``: first and last stamp of the log."""
        super().__init__(shown=sys.stderr.isatty() and not quiet)
        self._what = what
        self._start_ns = start_ns
        self._total_s = max(1e-9 * (end_ns - start_ns), 1e-9)
        self._begun_s = self._written_s = time.perf_counter()

    def at(self, stamp_ns: int) -> None:
        """The log has been worked through up to ``stamp_ns``."""
        now_s = time.perf_counter()
        if not self._shown or now_s - self._written_s < PERIOD_S:
            return
        self._written_s = now_s
        done_s = 1e-9 * (stamp_ns - self._start_ns)
        speed = done_s / (now_s - self._begun_s)
        self._write(
            f"{self._what}: {done_s / self._total_s:4.0%}  "
            f"{done_s:.0f} of {self._total_s:.0f} s  {speed:.0f} x real time"
        )


class Steps(OneLine):
    """What is under way, on standard error: one line that is written over on a terminal."""

    def __init__(self, what: str, *, elsewhere: bool = False) -> None:
        """``elsewhere``: a line for each step where that is no terminal."""
        super().__init__(shown=sys.stderr.isatty())
        self._what, self._elsewhere = what, elsewhere
        self._begun_s = time.perf_counter()
        self._written_s = 0.0
        self._step = ""

    def say(self, step: str, share: float | None) -> None:
        """``share`` of the step is done; None where nobody knows."""
        now_s = time.perf_counter()
        if step == self._step and (not self._shown or now_s - self._written_s < PERIOD_S):
            return
        self._step, self._written_s = step, now_s
        done = "" if share is None else f" {share:.0%}"
        line = f"{self._what}: {now_s - self._begun_s:4.0f} s  {step}{done if self._shown else ''}"
        if self._shown:
            self._write(line)
        elif self._elsewhere:
            sys.stderr.write(f"{line}\n")
