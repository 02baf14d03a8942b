"""No fault at all: open, first scan, rate, truth, stamps; and a reader who is busy elsewhere."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Final

import numpy as np

from amr_drivers.conformance.bench import BACK_S, Bench, Figures, at_bench
from amr_drivers.conformance.rig import MakeRig
from amr_drivers.conformance.scenarios.scenario import Effort
from amr_drivers.conformance.verdict import stamp_errors_s

_SECONDS: Final = {"quick": 2.0, "full": 20.0}
_LEAST: Final = 5
"""Sweeps of a slow scanner."""
_WARM: Final = 8
"""Scans before stamps are judged: what frees them from delays has to learn the period."""
_MISSED: Final = 2.0
"""Sweeps from one scan to the next, at the median: a driver that polls may just miss one."""
_P90: Final = 3.0
"""Times the tolerance: what one stamp in ten may exceed."""
_NAP_SWEEPS: Final = 10


def measuring(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Nothing is wrong. Every scan is true, none is missing in the long run, stamps are right."""

    def act(bench: Bench) -> None:
        if not bench.settle():
            return
        first = bench.runner.count
        seconds = _SECONDS[effort]
        bench.sweeps(max(_LEAST, round(seconds / bench.rig.period_s)))
        _judge_rate(bench, first)
        _judge_stamps(bench)
        complaints = [said.text for said in bench.listener.said[1:] if said.text is not None]
        bench.expect(len(complaints) <= 1, f"complains of nothing: {complaints[-1:]}")

    return at_bench(act, make, folder)


def _judge_rate(bench: Bench, first: int) -> None:
    numbers = [
        given.sweep.number
        for given in bench.listener.given
        if given.sweep is not None and given.sweep.number >= first
    ]
    bench.expect(len(numbers) >= 2, f"{len(numbers)} scans of {bench.runner.count - first} sweeps")
    if len(numbers) >= 2:
        step = float(np.median(np.diff(numbers)))
        bench.expect(step <= _MISSED, f"gives one scan in {step:g} sweeps")


def _judge_stamps(bench: Bench) -> None:
    errors = stamp_errors_s(bench.runner, bench.listener.given)
    errors_s = np.abs(errors[_WARM:] or errors)
    if not len(errors_s):
        return
    median_s, p90_s = np.quantile(errors_s, (0.5, 0.9))
    begun_ns = bench.listener.given[0].received_ns
    tolerance_s = bench.rig.stamp_tolerance_s
    allowed_s = tolerance_s + bench.stalls.median_s(begun_ns)
    bench.expect(
        median_s <= allowed_s, f"stamps are off by {median_s:.4f} s instead of {allowed_s:.4f}"
    )
    allowed_s = _P90 * tolerance_s + bench.stalls.worst_s(begun_ns)
    bench.expect(
        p90_s <= allowed_s, f"one stamp in ten is off by {p90_s:.4f} s instead of {allowed_s:.4f}"
    )
    bench.note = f"stamps off by {1e3 * median_s:.1f} ms, 90 % below {1e3 * p90_s:.1f} ms"


def slow_reader(make: MakeRig, folder: Path, _effort: Effort) -> Figures:
    """Nobody reads for ten sweeps; then the newest scan is given, and no older one ever."""

    def act(bench: Bench) -> None:
        if not bench.settle():
            return
        with bench.listener.busy_elsewhere():
            # The read that is under way may still give one.
            bench.sweeps(_NAP_SWEEPS)
            given = len(bench.listener.given)
            woken_ns, count = time.monotonic_ns(), bench.runner.count
        bench.listener.wait_for(lambda: len(bench.listener.given) > given, BACK_S)
        late = [item.sweep for item in bench.listener.given[given:]]
        stalled = math.ceil(bench.stalls.worst_s(woken_ns) / bench.rig.period_s)
        newest = late[0].number if late and late[0] is not None else None
        bench.expect(newest is not None, f"no true scan in {BACK_S:.0f} s after the pause")
        if newest is not None:
            behind = count - 1 - newest
            bench.expect(behind <= 1 + stalled, f"gives the scan of {behind} sweeps before")

    return at_bench(act, make, folder)
