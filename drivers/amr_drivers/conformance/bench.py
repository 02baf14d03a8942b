"""Where a scenario works: rig, sweeps and listener, what it found, and the limits."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from amr_drivers.conformance.leaks import Belongings
from amr_drivers.conformance.listener import Listener
from amr_drivers.conformance.replaying import other_scans
from amr_drivers.conformance.rig import MakeRig, Rig
from amr_drivers.conformance.runner import Runner
from amr_drivers.conformance.stalls import Stalls
from amr_drivers.conformance.verdict import false_scans

BACK_S: Final = 5.0
"""After a device has returned it must measure again within this."""
CLOSE_S: Final = 0.5
_DETECT_S: Final = 0.5
_DETECT_PERIODS: Final = 2.5
_NOTICE_S: Final = 0.1
"""What reading and asking may add: the listener asks for the status 50 times a second."""
_START_S: Final = 10.0
_SETTLED: Final = 3
"""Scans after which a driver is at work."""
_PATIENCE: Final = 3.0
"""Times a limit that are waited for: to say how much too late is better than "never"."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What a scenario measured; None where the fault has no such figure."""

    detected_s: float | None = None
    """From the first sign of the fault to the driver's complaint, the longest."""
    back_s: float | None = None
    """From the end of the fault to the first true scan, the longest."""
    lost: int | None = None
    """Sweeps after the end of the fault that were not given."""
    false: int = 0
    """Scans given that were damaged, mixed, doubled, old or stamped wrong."""
    note: str = ""
    breaches: tuple[str, ...] = ()
    """Where the driver broke a limit; empty: passed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """When something was done to the device."""

    stamp_ns: int
    sweep: int
    """Number of the first sweep that ends after it."""


class Bench:
    """Rig, runner and listener of one scenario, and its findings."""

    def __init__(self, rig: Rig, runner: Runner, listener: Listener, stalls: Stalls) -> None:
        self.rig = rig
        self.device = rig.device
        self.runner = runner
        self.listener = listener
        self.stalls = stalls
        self.breaches: list[str] = []
        self.note = ""
        self.begun = self.now()
        self._detected_s: list[float] = []
        self._back_s: list[float] = []
        self._lost: int | None = None

    def expect(self, condition: bool, breach: str) -> None:  # noqa: FBT001 - as in assert
        """Note a breach unless the condition holds."""
        if not condition:
            self.breaches.append(breach)

    def settle(self) -> bool:
        """Wait until the driver is at work. Without that there is nothing to find out."""

        def at_work() -> bool:
            given = self.listener.given[-_SETTLED:]
            return len(given) == _SETTLED and self.listener.complaint is None

        limit_s = _START_S + 2.0 * _SETTLED * self.rig.period_s
        settled = self.listener.wait_for(at_work, limit_s)
        self.expect(settled, f"not at work after {limit_s:.0f} s: {self.listener.complaint}")
        return settled

    def sweeps(self, count: int) -> None:
        """Wait for so many further sweeps to end."""
        until = self.runner.count + count
        limit_s = _START_S + 3.0 * count * self.rig.period_s
        if not self.listener.wait_for(lambda: self.runner.count >= until, limit_s):
            raise TimeoutError(f"the emulator has not swept {count} times in {limit_s:.0f} s")

    def now(self) -> Moment:
        """This moment."""
        return Moment(stamp_ns=time.monotonic_ns(), sweep=self.runner.count)

    def between_sweeps(self, act: Callable[[], object]) -> Moment:
        """Do something right before a sweep ends."""
        done: list[Moment] = []

        def act_and_note() -> None:
            done.append(self.now())
            act()

        self.runner.before_next(act_and_note)
        limit_s = _START_S + 3.0 * self.rig.period_s
        if not self.listener.wait_for(lambda: bool(done), limit_s):
            raise TimeoutError(f"the emulator has not swept in {limit_s:.0f} s")
        return done[0]

    def detect(
        self, fault: Moment, *, by_absence: bool = True, periods: float = _DETECT_PERIODS
    ) -> str | None:
        """Wait for the driver's complaint; its words.

        ``by_absence``: the fault shows by the end of the next sweep, with which the watch begins.
        ``periods``: so many may pass until it is known, where that is longer than 0.5 s.
        """
        limit_s = max(_DETECT_S, periods * self.rig.period_s) + _NOTICE_S
        patience_s = _PATIENCE * limit_s + 2.0 * self.rig.period_s
        self.listener.wait_for(
            lambda: self.listener.trouble_after(fault.stamp_ns) is not None, patience_s
        )
        said = self.listener.trouble_after(fault.stamp_ns)
        if said is None:
            self.breaches.append(f"not noticed in {patience_s:.1f} s")
            return None
        first = self.runner.after(fault.stamp_ns) if by_absence else None
        begun_ns = fault.stamp_ns if first is None else first.ended_ns
        detected_s = max(0.0, 1e-9 * (said.stamp_ns - begun_ns))
        self._detected_s.append(detected_s)
        allowed_s = limit_s + self.stalls.worst_s(fault.stamp_ns)
        self.expect(
            detected_s <= allowed_s, f"noticed after {detected_s:.2f} s instead of {allowed_s:.2f}"
        )
        return said.text

    def recover(self, over: Moment, *, spoilt: int = 0) -> None:
        """Wait for a scan of a sweep that ended after the fault was over.

        ``spoilt``: so many sweeps after it are its own victims and do not count as lost.
        """
        self.listener.wait_for(
            lambda: self.listener.scan_of_sweep(over.sweep) is not None, _PATIENCE * BACK_S
        )
        given = self.listener.scan_of_sweep(over.sweep)
        if given is None or given.sweep is None:
            self.breaches.append(
                f"not back in {_PATIENCE * BACK_S:.0f} s: {self.listener.complaint}"
            )
            return
        back_s = 1e-9 * (given.received_ns - over.stamp_ns)
        self._back_s.append(back_s)
        self._lost = (self._lost or 0) + max(0, given.sweep.number - over.sweep - spoilt)
        stall_s = self.stalls.worst_s(over.stamp_ns)
        allowed_s = max(BACK_S, _DETECT_PERIODS * self.rig.period_s) + stall_s
        self.expect(back_s <= allowed_s, f"back after {back_s:.2f} s instead of {allowed_s:.2f}")

    def content(self) -> None:
        """Wait until the driver complains no more: what is over must not be said for ever."""
        limit_s = max(BACK_S, _DETECT_PERIODS * self.rig.period_s)
        content = self.listener.wait_for(lambda: self.listener.complaint is None, limit_s)
        self.expect(content, f"still complains after {limit_s:.0f} s: {self.listener.complaint}")

    def figures(self) -> Figures:
        """To be called when the listener has stopped."""
        false = false_scans(self.rig, self.runner, self.listener.given, self.stalls)
        breaches = [*self.breaches, *false[:3]]
        slowest_s = max(self.listener.closing_s, default=0.0)
        allowed_s = CLOSE_S + self.stalls.worst_s(self.begun.stamp_ns)
        if slowest_s > allowed_s:
            breaches.append(f"close took {slowest_s:.2f} s instead of {allowed_s:.2f}")
        breaches += other_scans(self.rig, self.listener.sessions)
        return Figures(
            detected_s=max(self._detected_s, default=None),
            back_s=max(self._back_s, default=None),
            lost=self._lost,
            false=len(false),
            note=self.note,
            breaches=tuple(breaches),
        )


def at_bench(
    act: Callable[[Bench], object],
    make: MakeRig,
    folder: Path,
    *,
    prepare: Callable[[Rig], object] | None = None,
    recorded: bool = True,
) -> Figures:
    """Run a scenario with a listener on a rig of its own; then nothing may be left behind.

    ``prepare`` is called before the driver is opened.
    """
    before = Belongings.now()
    with Stalls() as stalls, make(folder) as rig:
        if prepare is not None:
            prepare(rig)
        with Runner(rig) as runner:
            with Listener(rig, runner, recorded=recorded) as listener:
                bench = Bench(rig, runner, listener, stalls)
                act(bench)
            figures = bench.figures()
    left = before.left_since()
    return replace(figures, breaches=(*figures.breaches, *left))
