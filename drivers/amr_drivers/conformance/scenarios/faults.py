"""The device or its line fails as a whole, and comes back."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from amr_drivers.conformance.bench import Bench, Figures, Moment, at_bench
from amr_drivers.conformance.rig import MakeRig
from amr_drivers.conformance.scenarios.scenario import Effort
from amr_drivers.conformance.speeches import SPEECHES

_TIMES: Final = {"quick": 1, "full": 5}
_LONGER: Final = 3
"""Sweeps that a fault lasts on after it was noticed: nothing may come meanwhile."""
_FROZEN_PERIODS: Final = 3.0
"""A scan must be repeated to be known as repeated (fault catalogue, row 4)."""
_DARK_SWEEPS: Final = 3


def silence(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """The device sends and answers nothing; no connection is cut. Then it is back."""

    def act(bench: Bench) -> None:
        for _ in range(_TIMES[effort]):
            if not bench.settle():
                return
            words = bench.detect(_set(bench, silent=True))
            bench.sweeps(_LONGER)
            bench.recover(_set(bench, silent=False))
            bench.content()
            bench.note = f"says {words!r}"

    return at_bench(act, make, folder)


def unplugged(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """The cable is pulled so that the system knows it (adapter gone, connection reset)."""

    def act(bench: Bench) -> None:
        for _ in range(_TIMES[effort]):
            if not bench.settle():
                return
            pulled = bench.now()
            bench.device.unplug()
            bench.detect(pulled, by_absence=False)
            bench.sweeps(_LONGER)
            back = bench.now()
            bench.device.replug()
            bench.recover(back)
            bench.content()

    return at_bench(act, make, folder)


def power_cycle(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Counters, clocks and sessions start anew, at once and after a while in the dark."""

    def act(bench: Bench) -> None:
        for _ in range(_TIMES[effort]):
            if not bench.settle():
                return
            bench.recover(bench.between_sweeps(bench.device.power_cycle))
            if not bench.settle():
                return
            _set(bench, silent=True)
            bench.sweeps(_DARK_SWEEPS)
            bench.between_sweeps(bench.device.power_cycle)
            bench.recover(_set(bench, silent=False))
            bench.content()

    return at_bench(act, make, folder)


def frozen(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """The same scan with the same counter again and again."""

    def act(bench: Bench) -> None:
        for _ in range(_TIMES[effort]):
            if not bench.settle():
                return
            words = bench.detect(_set(bench, frozen=True), periods=_FROZEN_PERIODS)
            bench.sweeps(_LONGER)
            bench.recover(_set(bench, frozen=False))
            bench.content()
            bench.note = f"says {words!r}"

    return at_bench(act, make, folder)


def standby(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """The device lives and measures nothing; what it sends then is no scan."""

    def act(bench: Bench) -> None:
        for _ in range(_TIMES[effort]):
            if not bench.settle():
                return
            words = bench.detect(_set(bench, mode="standby"))
            bench.sweeps(_LONGER)
            bench.recover(_set(bench, mode="measuring"))
            bench.content()
            bench.note = f"says {words!r}"

    return at_bench(act, make, folder)


def wrong_device(make: MakeRig, folder: Path, _effort: Effort) -> Figures:
    """Something else answers at this port: never a scan, and it is said or the open fails."""
    found = {}
    for name, speech in SPEECHES.items():
        own = folder / name.replace(" ", "_")
        own.mkdir()
        found[name] = _stranger(speech, make, own)
    return Figures(
        detected_s=max((f.detected_s for f in found.values() if f.detected_s), default=None),
        false=sum(f.false for f in found.values()),
        note="; ".join(f"{name}: {f.note}" for name, f in found.items()),
        breaches=tuple(f"{name}: {text}" for name, f in found.items() for text in f.breaches),
    )


def _stranger(speech: bytes, make: MakeRig, folder: Path) -> Figures:
    def act(bench: Bench) -> None:
        bench.runner.before_each(lambda: bench.device.send_bytes(speech))
        words = bench.detect(bench.begun)
        bench.sweeps(_LONGER)
        bench.expect(not bench.listener.given, f"{len(bench.listener.given)} scans of a stranger")
        bench.note = f"{words!r}"

    return at_bench(act, make, folder, prepare=lambda rig: rig.device.be_another_device(speech))


def _set(bench: Bench, **state: bool | str) -> Moment:
    """Change what the device is, between two sweeps."""

    def change() -> None:
        for name, value in state.items():
            setattr(bench.device, name, value)

    return bench.between_sweeps(change)
