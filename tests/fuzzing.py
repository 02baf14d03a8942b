"""Fuzz targets by name, what they have been fed with, and how inputs are changed.

A target is a module ``tests/fuzz/NAME.py`` with ``target(data)``, which raises what no parser may
raise (AssertionError for a broken property), and ``seeds()``, valid inputs by our own encoders.
"""

from __future__ import annotations

import importlib.util
import random
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Final, Protocol, cast

from paths import REPO

CORPUS: Final = REPO / "tests/fuzz/corpus"
_CORPUS_BYTES: Final = 8192
_FOLDER: Final = REPO / "tests/fuzz"
_SPECIAL: Final = (0, 1, 2, 3, 0x7F, 0x80, 0xFE, 0xFF)


class Target(Protocol):
    """A module of tests/fuzz."""

    def target(self, data: bytes) -> None: ...

    def seeds(self) -> list[bytes]: ...


def names() -> list[str]:
    """All targets, sorted."""
    return sorted(path.stem for path in _FOLDER.glob("*.py"))


def load(name: str) -> Target:
    """The module of a target."""
    spec = importlib.util.spec_from_file_location(f"fuzz_{name}", _FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return cast("Target", module)


def corpus(name: str, folder: Path = CORPUS) -> list[bytes]:
    """Inputs that fuzzing found and that are worth keeping: a line of hex digits each."""
    path = folder / name / "inputs.hex"
    lines = path.read_text(encoding="ascii").split("\n") if path.exists() else []
    return [bytes.fromhex(line) for line in lines if line]


def write_corpus(name: str, inputs: Sequence[bytes], folder: Path = CORPUS) -> None:
    """The shortest inputs, as many as the corpus has room for."""
    path = folder / name / "inputs.hex"
    path.parent.mkdir(parents=True, exist_ok=True)
    room, lines = _CORPUS_BYTES, []
    for data in sorted(set(inputs), key=lambda data: (len(data), data)):
        room -= len(data)
        if room >= 0:
            lines.append(data.hex() + "\n")
    path.write_text("".join(lines), encoding="ascii")


def read_inputs(folder: Path) -> list[bytes]:
    """What fuzzing has found in this folder so far."""
    return [path.read_bytes() for path in sorted(folder.glob("inputs/*"))]


def write_inputs(inputs: Sequence[bytes], folder: Path) -> Path:
    """Where inputs to begin with lie as files, and where new ones may be put."""
    where = folder / "inputs"
    where.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(inputs):
        (where / f"known-{number}").write_bytes(data)
    return where


def change_at_random(name: str, runs: int, folder: Path) -> int:
    """Feed a target with so many changes of all inputs known; how many inputs that were.

    What breaks the parser is written to the folder before its exception goes on.
    """
    target = load(name)
    inputs = sorted({*target.seeds(), *corpus(name), *read_inputs(folder)})
    data = b""
    try:
        for data in islice(mutations(inputs, seed=time.time_ns()), runs):
            target.target(data)
    except BaseException:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"crash-{zlib.crc32(data):08x}").write_bytes(data)
        raise
    return len(inputs)


def mutations(inputs: Sequence[bytes], seed: int) -> Iterator[bytes]:
    """Endlessly, one to six small changes of one of the inputs. The same seed, the same ones."""
    dice = random.Random(seed)
    draw = dice.random
    # What a parser does with the fifth telegram it does with the first.
    longest = 2 * max(map(len, inputs)) + 16
    while True:
        data = bytearray(inputs[int(draw() * len(inputs))])
        for _ in range(1 + int(5 * draw() ** 2)):
            _change(data, inputs, draw)
        yield bytes(data[:longest])


def _change(data: bytearray, inputs: Sequence[bytes], draw: Callable[[], float]) -> None:
    kind, at = int(draw() * 7), int(draw() * (len(data) + 1))
    end = at + 1 + int(8 * draw() ** 2)
    if kind == 0 and at < len(data):
        data[at] ^= 1 << int(8 * draw())
    elif kind == 1 and at < len(data):
        data[at] = _SPECIAL[int(draw() * len(_SPECIAL))]
    elif kind == 2 and at < len(data):
        data[at] = int(256 * draw())
    elif kind == 3:
        del data[at:end]
    elif kind == 4:
        data[at:at] = data[at:end]
    elif kind == 5:
        data[at:at] = bytes((int(256 * draw()),))
    else:
        other = inputs[int(draw() * len(inputs))]
        data[at:] = other[min(at, int(draw() * (len(other) + 1))) :]
