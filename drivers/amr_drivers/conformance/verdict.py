"""Which of the scans that a driver gave were not true."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from amr_drivers.conformance.listener import Given
from amr_drivers.conformance.rig import Rig
from amr_drivers.conformance.runner import Runner
from amr_drivers.conformance.stalls import Stalls

OLD_S: Final = 0.5
OLD_PERIODS: Final = 2.5
"""A scan whose first beam is older than the longer of both was sold as new."""
_STAMP_S: Final = 0.1
"""A single stamp that is off by more than this and what the line is good for, and by more than a
period, is another sweep's."""
_MEMORY_NS: Final = 4_000_000_000
"""For so long a delay of this machine may show in stamps: they go by many arrivals."""


def false_scans(rig: Rig, runner: Runner, given: Sequence[Given], stalls: Stalls) -> list[str]:
    """What is wrong with each scan that is no true one, in words."""
    false: list[str] = []
    last = -1
    for item in given:
        reason = _falsehood(rig, runner, item, stalls, last)
        if reason is not None:
            false.append(reason)
        elif item.sweep is not None:
            last = item.sweep.number
    return false


def stamp_errors_s(runner: Runner, given: Sequence[Given]) -> list[float]:
    """How late each stamp is of the sweep's first beam, in s."""
    return [
        1e-9 * (item.scan.stamp_ns - truth_ns)
        for item in given
        if item.sweep is not None and (truth_ns := runner.stamp_ns(item.sweep.number)) is not None
    ]


def _falsehood(rig: Rig, runner: Runner, item: Given, stalls: Stalls, last: int) -> str | None:
    scan, sweep = item.scan, item.sweep
    if sweep is None:
        return f"a scan that no sweep was like (counter {scan.seq})"
    if sweep.number == last:
        return f"sweep {sweep.number} given twice"
    if sweep.number < last:
        return f"sweep {sweep.number} given after sweep {last}"
    truth_ns = runner.stamp_ns(sweep.number)
    if truth_ns is None:
        return f"sweep {sweep.number} given before it was measured"
    return next(_wrong_times(rig, item, truth_ns, stalls), None)


def _wrong_times(rig: Rig, item: Given, truth_ns: int, stalls: Stalls) -> Iterator[str]:
    scan = item.scan
    stall_s = stalls.worst_s(truth_ns - _MEMORY_NS, item.received_ns)
    age_s = 1e-9 * (item.received_ns - truth_ns)
    if age_s > max(OLD_S, OLD_PERIODS * rig.period_s) + stall_s:
        yield f"a scan given {age_s:.2f} s after its first beam"
    error_s = 1e-9 * (scan.stamp_ns - truth_ns)
    if abs(error_s) > max(_STAMP_S + rig.stamp_tolerance_s, rig.period_s) + stall_s:
        yield f"a stamp that is off by {error_s:+.3f} s"
    if scan.stamp_ns + round(1e9 * scan.sweep_s) > item.received_ns:
        yield "a scan that ends after it was given"
