"""Telegrams that are cut or damaged, and noise between them."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from amr_drivers.conformance.bench import Bench, Figures, at_bench
from amr_drivers.conformance.leaks import resident_bytes
from amr_drivers.conformance.rig import MakeRig
from amr_drivers.conformance.scenarios.scenario import Effort

_HEADER: Final = {"quick": 16, "thorough": 64}
"""Bytes of a telegram that are all cut at; beyond them, evenly."""
_BODY: Final = {"quick": 12, "thorough": 136}
_SECONDS: Final = {"quick": 4.0, "thorough": 60.0}
_TURNS: Final = 4
"""Periods that a cut or a damage takes until the next true scan, and a little more."""
_LEAST: Final = 4
_SEEDS: Final = {"quick": 24, "thorough": 200, "full": 1000}
_FLOOD_BYTES: Final = 50_000_000
_PIECE: Final = 1024
_SHRED: Final = 48
"""Bytes of a true telegram: its head, its middle or its end, never all of it."""
_GROWTH_BYTES: Final = 16_000_000
"""What the process may have grown by: less than two of the five kinds of noise."""


def cut(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """A telegram ends early, at each of many bytes in turn. Its half is never sold, nor joined to
    what comes next; the next scan comes in time."""

    def act(bench: Bench) -> None:
        bench.settle()
        cuts = 0
        for at_byte in _in_time(_positions(bench, effort), effort):
            cuts += 1
            bench.recover(bench.between_sweeps(partial(bench.device.cut_next, at_byte)), spoilt=1)
        bench.content()
        bench.note = f"cut at {cuts} of {bench.rig.telegram_bytes} bytes"

    return at_bench(act, make, folder)


def damaged(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Every second telegram is damaged in one of the ways of its line: never a scan."""

    def act(bench: Bench) -> None:
        bench.settle()
        for seed in _in_time(range(_affordable(bench, _SEEDS[effort], effort)), effort):
            bench.recover(bench.between_sweeps(partial(bench.device.damage_next, seed)), spoilt=1)
        bench.content()
        bench.note = f"{bench.listener.errors} counted by the last session's driver"

    return at_bench(act, make, folder)


def noise(make: MakeRig, folder: Path, effort: Effort) -> Figures:
    """Up to 3000 bytes of noise between telegrams, half of them zero as in headers."""

    def act(bench: Bench) -> None:
        bench.settle()
        dice = random.Random(1)
        for _ in _in_time(range(_affordable(bench, _SEEDS[effort], effort)), effort):
            data = _noise(dice, dice.randrange(1, 3000))
            bench.recover(bench.between_sweeps(partial(bench.device.send_bytes, data)))
        bench.content()

    return at_bench(act, make, folder)


def flood(make: MakeRig, folder: Path, _effort: Effort) -> Figures:
    """50 MB as fast as the line takes them: of one byte each, of noise, of telegrams' pieces."""

    def act(bench: Bench) -> None:
        bench.settle()
        heard = bench.listener.stop_recording()
        before = resident_bytes()
        grown = 0
        kinds = _floods(random.Random(2), heard)
        for pieces in kinds:
            for n in range(_FLOOD_BYTES // len(kinds) // _PIECE):
                bench.device.send_bytes(pieces[n % len(pieces)])
            grown = max(grown, resident_bytes() - before)
        bench.recover(bench.now())
        bench.content()
        bench.note = f"grown by {grown / 1e6:.1f} MB"
        bench.expect(grown <= _GROWTH_BYTES, f"memory grew by {grown / 1e6:.0f} MB")

    return at_bench(act, make, folder)


def _floods(dice: random.Random, heard: bytes) -> list[list[bytes]]:
    """Kinds of noise, each as pieces to be sent in turn."""
    starts = [dice.randrange(max(1, len(heard) - _SHRED)) for _ in range(_PIECE)]
    shreds = b"".join(heard[start : start + _SHRED] for start in starts)
    return [
        [_PIECE * b"\x00"],
        [_PIECE * b"\x02"],
        [_PIECE * b"A"],
        [_noise(dice, _PIECE) for _ in range(16)],
        [shreds[n : n + _PIECE] for n in range(0, len(shreds), _PIECE)],
    ]


def _positions(bench: Bench, effort: Effort) -> list[int]:
    length = bench.rig.telegram_bytes
    if effort == "full":
        return list(range(length))
    header, parts = range(min(_HEADER[effort], length)), _BODY[effort]
    body = [length - 1 - n * (length - len(header)) // parts for n in range(parts)]
    chosen = sorted({*header, *(at for at in body if at >= 0)})
    count = _affordable(bench, len(chosen), effort)
    positions = [chosen[n * len(chosen) // count] for n in range(count)]
    # Time may be up before the last: head and body must both have had their turn.
    random.Random(4).shuffle(positions)
    return positions


def _affordable(bench: Bench, wanted: int, effort: Effort) -> int:
    """How many faults a slow scanner has time for."""
    if effort == "full":
        return wanted
    return min(wanted, max(_LEAST, round(_SECONDS[effort] / (_TURNS * bench.rig.period_s))))


def _in_time(items: Sequence[int], effort: Effort) -> Iterator[int]:
    """The items until time is up: some devices take a second to be found again."""
    begun_s = time.monotonic()
    for number, item in enumerate(items):
        spent_s = time.monotonic() - begun_s
        if effort != "full" and number >= _LEAST and spent_s > 2.0 * _SECONDS[effort]:
            return
        yield item


def _noise(dice: random.Random, count: int) -> bytes:
    return bytes(dice.choice((0, dice.randrange(256))) for _ in range(count))
