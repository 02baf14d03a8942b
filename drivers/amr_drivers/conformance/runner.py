"""Sweeps of an emulated scanner, each of its own pattern, and the truth about them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np

from amr_drivers.conformance.rig import Rig
from amr_slam.geometry import Array, readonly

_REMEMBERED = 500
"""Sweeps whose pattern is known: an older scan is as false as one that never was."""
_NO_RETURN_SHARE = 0.03
_NOT_MEASURED_SHARE = 0.03


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sweep:
    """What one sweep truly was."""

    number: int
    ended_ns: int
    """When the emulator was told of it."""
    ranges_m: Array
    """(beams,) read-only, as in :class:`amr_slam.samples.Scan`."""


def pattern(number: int, beams: int) -> Array:
    """The ranges of a sweep: (beams,), 0.5 to 20 m, some inf, some NaN.

    Any two sweeps differ at nearly every beam: a scan made of two of them, or of a damaged one,
    equals none.
    """
    dice = np.random.default_rng((number, beams))
    ranges: Array = dice.uniform(0.5, 20.0, beams)
    kinds = dice.random(beams)
    ranges[kinds < _NO_RETURN_SHARE + _NOT_MEASURED_SHARE] = np.inf
    ranges[kinds < _NOT_MEASURED_SHARE] = np.nan
    return readonly(ranges)


class Runner:
    """A thread that lets the emulated scanner sweep evenly; a context manager."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._lock = threading.Lock()
        self._sweeps: deque[Sweep] = deque(maxlen=_REMEMBERED)
        self._stamps_ns: dict[int, int] = {}
        self._count = 0
        self._before: deque[Callable[[], object]] = deque()
        self._always: Callable[[], object] | None = None
        self._stopping = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="conformance-runner", daemon=True)

    @property
    def count(self) -> int:
        """Sweeps so far: the number of the newest one is this less 1."""
        return self._count

    def before_next(self, act: Callable[[], object]) -> None:
        """Have something done between two sweeps, right before the next one."""
        self._before.append(act)

    def before_each(self, act: Callable[[], object]) -> None:
        """Have something done right before every sweep from now on."""
        self._always = act

    def after(self, stamp_ns: int) -> Sweep | None:
        """The first sweep that ended at or after this instant; None while there is none."""
        with self._lock:
            return next((sweep for sweep in self._sweeps if sweep.ended_ns >= stamp_ns), None)

    def matching(self, ranges_m: Array, tolerance_m: float) -> Sweep | None:
        """The sweep that these ranges are, beam for beam; None: never was, or is long ago."""
        with self._lock:
            newest_first = list(reversed(self._sweeps))
        return next((s for s in newest_first if equal(ranges_m, s.ranges_m, tolerance_m)), None)

    def stamp_ns(self, number: int) -> int | None:
        """The truth for a scan's stamp; None while the emulator is still about that sweep."""
        return self._stamps_ns.get(number)

    def check(self) -> None:
        """Raises what the emulator raised in the thread: a fault of the rig, not of the driver."""
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Idempotent."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    def _run(self) -> None:
        try:
            self._sweep_evenly()
        except BaseException as failure:  # noqa: BLE001 - handed to the scenario by check()
            self._failure = failure

    def _sweep_evenly(self) -> None:
        period_ns = round(1e9 * self._rig.period_s)
        due_ns = time.monotonic_ns() + period_ns
        while not self._stopping.wait(max(0, due_ns - time.monotonic_ns()) * 1e-9):
            while self._before:
                self._before.popleft()()
            if self._always is not None:
                self._always()
            ranges = pattern(self._count, self._rig.beams)
            sweep = Sweep(number=self._count, ended_ns=time.monotonic_ns(), ranges_m=ranges)
            # Before it leaves: the scan may be back before the emulator returns.
            with self._lock:
                self._sweeps.append(sweep)
            self._stamps_ns[sweep.number] = self._rig.device.measure(ranges)
            self._count += 1
            # A mirror that was held up goes on from where it is: no burst makes up for it.
            due_ns = max(due_ns + period_ns, time.monotonic_ns())


def equal(ranges_m: Array, truth_m: Array, tolerance_m: float) -> bool:
    """Whether ranges are the truth but for rounding; inf and NaN must be where they are there."""
    if ranges_m.shape != truth_m.shape:
        return False
    finite = np.isfinite(truth_m)
    if not np.array_equal(ranges_m[~finite], truth_m[~finite], equal_nan=True):
        return False
    # A NaN or inf where there must be none fails the comparison, too.
    return bool(np.all(np.abs(ranges_m[finite] - truth_m[finite]) <= tolerance_m + 1e-9))
