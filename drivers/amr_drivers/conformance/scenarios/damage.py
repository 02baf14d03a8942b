"""Telegrams that are cut or damaged, and noise between them."""

from __future__ import annotations

import random
from functools import partial
from pathlib import Path
from typing import Final

from amr_drivers.conformance.bench import Bench, Figures, at_bench
from amr_drivers.conformance.leaks import resident_bytes
from amr_drivers.conformance.rig import MakeRig
from amr_drivers.conformance.scenarios.scenario import Effort

_HEADER: Final = 16
"""Bytes of a telegram that are all cut at; beyond them, evenly."""
_BODY: Final = 12
_QUICK_S: Final = 4.0
_TURNS: Final = 4
"""Periods that a cut or a damage takes until the next true scan, and a little more."""
_LEAST: Final = 4
_SEEDS: Final = {"quick": 24, "full": 400}
_FLOOD_BYTES: Final = 50_000_000
_PIECE: Final = 1024
_GROWTH_BYTES: Final = 16_000_000
"""What the process may have grown by: not a third of the noise."""


def cut(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """A telegram ends early, at each of many bytes in turn. Its half is never sold, nor joined to
    what comes next; the next scan comes in time."""

    def act(bench: Bench) -> None:
        if not bench.settle():
            return
        positions = _positions(bench, effort)
        for at_byte in positions:
            bench.recover(bench.between_sweeps(partial(bench.device.cut_next, at_byte)), spoilt=1)
        bench.content()
        bench.note = f"cut at {len(positions)} of {bench.rig.telegram_bytes} bytes"

    return at_bench(act, make, folder)


def damaged(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Every second telegram is damaged in one of the ways of its line: never a scan."""

    def act(bench: Bench) -> None:
        if not bench.settle():
            return
        for seed in range(_affordable(bench, _SEEDS[effort], effort)):
            bench.recover(bench.between_sweeps(partial(bench.device.damage_next, seed)), spoilt=1)
        bench.content()
        bench.note = f"{bench.listener.errors} counted by the last session's driver"

    return at_bench(act, make, folder)


def noise(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Up to 3000 bytes of noise between telegrams, half of them zero as in headers."""

    def act(bench: Bench) -> None:
        if not bench.settle():
            return
        dice = random.Random(1)
        for _ in range(_affordable(bench, _SEEDS[effort], effort)):
            data = _noise(dice, dice.randrange(1, 3000))
            bench.recover(bench.between_sweeps(partial(bench.device.send_bytes, data)))
        bench.content()

    return at_bench(act, make, folder)


def flood(make: MakeRig, folder: Path, _effort: Effort) -> Figures:
    """50 MB as fast as the line takes them: noise, and beginnings of telegrams without an end."""

    def act(bench: Bench) -> None:
        if not bench.settle():
            return
        dice = random.Random(2)
        pieces = [_noise(dice, _PIECE) for _ in range(16)]
        before = resident_bytes()
        most = before
        for n in range(_FLOOD_BYTES // _PIECE):
            bench.device.send_bytes(pieces[n % len(pieces)])
            if n % 256 == 0:
                most = max(most, resident_bytes())
        bench.recover(bench.now())
        bench.content()
        grown = max(most, resident_bytes()) - before
        bench.note = f"grown by {grown / 1e6:.1f} MB"
        bench.expect(grown <= _GROWTH_BYTES, f"memory grew by {grown / 1e6:.0f} MB")

    return at_bench(act, make, folder, recorded=False)


def _positions(bench: Bench, effort: Effort) -> list[int]:
    length = bench.rig.telegram_bytes
    if effort == "full":
        return list(range(length))
    header = range(min(_HEADER, length))
    body = [length - 1 - n * (length - len(header)) // _BODY for n in range(_BODY)]
    chosen = sorted({*header, *(at for at in body if at >= 0)})
    count = _affordable(bench, len(chosen), effort)
    return [chosen[n * len(chosen) // count] for n in range(count)]


def _affordable(bench: Bench, wanted: int, effort: Effort) -> int:
    """How many faults a slow scanner has time for."""
    if effort == "full":
        return wanted
    return min(wanted, max(_LEAST, round(_QUICK_S / (_TURNS * bench.rig.period_s))))


def _noise(dice: random.Random, count: int) -> bytes:
    return bytes(dice.choice((0, dice.randrange(256))) for _ in range(count))
