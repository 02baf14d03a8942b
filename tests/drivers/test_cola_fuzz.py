from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from fuzz import cola_a, cola_b
from hypothesis import given, settings
from hypothesis import strategies as st

TARGETS: dict[str, tuple[Callable[[bytes], None], list[bytes]]] = {
    "a": (cola_a.target, cola_a.seeds()),
    "b": (cola_b.target, cola_b.seeds()),
}


@pytest.mark.parametrize("dialect", TARGETS)
@settings(max_examples=300, derandomize=True, deadline=None)
@given(data=st.data())
def test_any_bytes_are_taken(dialect: str, data: st.DataObject) -> None:
    target, seeds = TARGETS[dialect]
    parts = data.draw(st.lists(st.sampled_from(seeds) | st.binary(max_size=40), max_size=4))
    stream = bytearray(b"".join(parts))
    dice = random.Random(data.draw(st.integers(0, 2**32)))
    for _ in range(data.draw(st.integers(0, 4)) if stream else 0):
        stream[dice.randrange(len(stream))] = dice.randrange(256)
    target(bytes(stream))


@pytest.mark.parametrize("dialect", TARGETS)
def test_seeds_pass(dialect: str) -> None:
    target, seeds = TARGETS[dialect]
    for seed in seeds:
        target(seed)
