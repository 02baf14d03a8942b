"""A driver is closed, in every state of its device; and often."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from amr_drivers.conformance.bench import CLOSE_S, Figures
from amr_drivers.conformance.leaks import Belongings
from amr_drivers.conformance.rig import MakeRig, Rig
from amr_drivers.conformance.runner import Runner
from amr_drivers.conformance.scenarios.scenario import Effort
from amr_drivers.conformance.speeches import SPEECHES
from amr_drivers.conformance.stalls import Stalls
from amr_drivers.errors import DriverError
from amr_slam.samples import Scanner

_CONNECT_S: Final = 3.0
"""What opening a device may take that does not answer: a stop has to wait for it."""
_OPEN_S: Final = 0.3
"""Open for so long before it is closed: whatever a driver does then is under way."""
_LONG_S: Final = 60.0
_ROUNDS: Final = {"quick": 10, "full": 100}
_FLOOD: Final = 64 * (b"\x00\x02\x55\xaa" * 256,)
"""What a full line holds: more than any kernel keeps of it is sent between two sweeps."""


def stop(make: MakeRig, folder: Path, _effort: Effort) -> Figures:
    """Closed while a read waits: both are over within 0.5 s, whatever the device does."""
    before = Belongings.now()
    breaches: list[str] = []
    slowest_s = 0.0
    with Stalls() as stalls, make(folder) as rig, Runner(rig) as runner:
        for state, act in _states(rig, runner).items():
            act()
            for open_s in (0.0, _OPEN_S):
                took_s, found = _closed(rig, open_s, stalls)
                slowest_s = max(slowest_s, took_s)
                breaches += [f"{state}: {breach}" for breach in found]
    return Figures(note=f"slowest {slowest_s:.2f} s", breaches=(*breaches, *before.left_since()))


def open_and_close(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Again and again: nothing is left behind, and each time it works."""
    before = Belongings.now()
    breaches: list[str] = []
    with make(folder) as rig, Runner(rig):
        for _ in range(_ROUNDS[effort]):
            scanner = rig.open()
            if scanner.read(_LONG_S) is None:
                breaches.append(f"no scan in {_LONG_S:.0f} s")
            scanner.close()
            scanner.close()
            if not scanner.info().model:
                breaches.append("has no model")
    return Figures(note=f"{_ROUNDS[effort]} times", breaches=(*breaches, *before.left_since()))


def _states(rig: Rig, runner: Runner) -> dict[str, Callable[[], object]]:
    """What to do to have the device in each state, one after another."""
    device = rig.device

    def set_to(*, silent: bool = False, frozen: bool = False, standby: bool = False) -> None:
        device.silent, device.frozen = silent, frozen
        device.mode = "standby" if standby else "measuring"

    def flood() -> None:
        for piece in _FLOOD:
            device.send_bytes(piece)

    def fill_the_line() -> None:
        device.replug()
        runner.before_each(flood)

    def be_another() -> None:
        runner.before_each(lambda: None)
        device.be_another_device(SPEECHES["HTTP server"])

    return {
        "measuring": set_to,
        "silent": partial(set_to, silent=True),
        "frozen": partial(set_to, frozen=True),
        "standby": partial(set_to, standby=True),
        "unplugged": device.unplug,
        "full line": fill_the_line,
        "another device": be_another,
    }


def _closed(rig: Rig, open_s: float, stalls: Stalls) -> tuple[float, list[str]]:
    """How long close and the waiting read took, and breaches."""
    begun_ns = time.monotonic_ns()
    try:
        scanner = rig.open()
    except DriverError:
        scanner = None
    opening_s = 1e-9 * (time.monotonic_ns() - begun_ns)
    breaches = []
    if opening_s > _CONNECT_S + stalls.worst_s(begun_ns):
        breaches.append(f"opening took {opening_s:.2f} s")
    if scanner is None:
        return 0.0, breaches
    reader = threading.Thread(target=_read_all, args=(scanner,), name="conformance-reader")
    reader.start()
    reader.join(open_s)
    closing_ns = time.monotonic_ns()
    scanner.close()
    reader.join(_LONG_S)
    took_s = 1e-9 * (time.monotonic_ns() - closing_ns)
    allowed_s = CLOSE_S + stalls.worst_s(closing_ns)
    if took_s > allowed_s:
        breaches.append(f"close took {took_s:.2f} s instead of {allowed_s:.2f}")
    return took_s, breaches


def _read_all(scanner: Scanner) -> None:
    """Read until the driver says that it is closed."""
    with contextlib.suppress(DriverError):
        while True:
            scanner.read(_LONG_S)
