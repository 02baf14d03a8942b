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

_SECONDS: Final = {"quick": 2.0, "thorough": 20.0, "full": 120.0}
_LEAST: Final = 5
"""Sweeps of a slow scanner."""
_WARM: Final = 8
"""Scans before stamps are judged: what frees them from delays has to learn the period."""
_MISSED: Final = 2.0
"""Sweeps from one scan to the next, at the median: a driver that polls may just miss one."""
_P90: Final = 3.0
"""Times the tolerance: what one stamp in ten may exceed."""
_PAUSE_S: Final = 0.25
_NAP_SWEEPS: Final = 10
_BEHIND: Final = 3
"""Sweeps by which the newest scan may lag: 2.5 periods, as everywhere, in whole ones."""


def measuring(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Nothing is wrong. Every scan is true, none is missing in the long run, stamps are right."""

    def act(bench: Bench) -> None:
        bench.settle()
        settled = bench.now()
        seconds = _SECONDS[effort]
        bench.sweeps(max(_LEAST, round(seconds / bench.rig.period_s)))
        _judge_rate(bench, settled.sweep)
        _judge_stamps(bench)
        said = bench.listener.trouble_after(settled.stamp_ns)
        still_s = bench.stalls.worst_s(settled.stamp_ns)
        # Where nothing came through for so long, the driver has something to complain of.
        paused = still_s > max(_PAUSE_S, bench.rig.period_s)
        bench.expect_in_time(said is None or paused, f"complains of nothing: {said}")

    return at_bench(act, make, folder)


def _judge_rate(bench: Bench, first: int) -> None:
    numbers = [
        given.sweep.number
        for given in bench.listener.given
        if given.sweep is not None and given.sweep.number >= first
    ]
    bench.expect_in_time(
        len(numbers) >= 2, f"{len(numbers)} scans of {bench.runner.count - first} sweeps"
    )
    if len(numbers) >= 2:
        step = float(np.median(np.diff(numbers)))
        bench.expect_in_time(step <= _MISSED, f"gives one scan in {step:g} sweeps")


def _judge_stamps(bench: Bench) -> None:
    errors = stamp_errors_s(bench.runner, bench.listener.given)
    errors_s = np.abs(errors[_WARM:] or errors)
    if not len(errors_s):
        return
    median_s, p90_s = np.quantile(errors_s, (0.5, 0.9))
    begun_ns = bench.listener.given[0].received_ns
    tolerance_s = bench.rig.stamp_tolerance_s
    allowed_s = tolerance_s + bench.stalls.usual_s(begun_ns)
    bench.expect_in_time(
        median_s <= allowed_s, f"stamps are off by {median_s:.4f} s instead of {allowed_s:.4f}"
    )
    allowed_s = _P90 * tolerance_s + bench.stalls.worst_s(begun_ns)
    bench.expect_in_time(
        p90_s <= allowed_s, f"one stamp in ten is off by {p90_s:.4f} s instead of {allowed_s:.4f}"
    )
    bench.note = f"stamps off by {1e3 * median_s:.1f} ms, 90 % below {1e3 * p90_s:.1f} ms"


def slow_reader(make: MakeRig, folder: Path, _effort: Effort) -> Figures:
    """Nobody reads for ten sweeps; then the newest scan is given, and no older one ever."""

    def act(bench: Bench) -> None:
        bench.settle()
        begun_ns = time.monotonic_ns()
        with bench.listener.busy_elsewhere():
            # The read that is under way may still give one.
            bench.sweeps(_NAP_SWEEPS)
            given = len(bench.listener.given)
            count = bench.runner.count
        bench.listener.wait_for(lambda: len(bench.listener.given) > given, BACK_S)
        late = [item.sweep for item in bench.listener.given[given:]]
        stalled = math.ceil(bench.stalls.worst_s(begun_ns) / bench.rig.period_s)
        newest = late[0].number if late and late[0] is not None else None
        bench.expect_in_time(newest is not None, f"no true scan in {BACK_S:.0f} s after the pause")
        if newest is not None:
            behind = count - 1 - newest
            bench.expect_in_time(
                behind <= _BEHIND + stalled, f"gives the scan of {behind} sweeps before"
            )

    return at_bench(act, make, folder)
