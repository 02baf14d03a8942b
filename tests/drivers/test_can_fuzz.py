"""The fuzz targets of the CAN decoders hold for their seeds and for what is near to them."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import REPO


def target(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, REPO / f"tests/fuzz/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TARGETS = {name: target(name) for name in ("can_frames", "can_cia402")}


@pytest.mark.parametrize("name", TARGETS)
@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.data())
def test_seeds_and_damaged_seeds(name: str, data: st.DataObject) -> None:
    module = TARGETS[name]
    seed = bytearray(data.draw(st.sampled_from(module.seeds() * 3)))
    for _ in range(data.draw(st.integers(0, 4))):
        if seed:
            seed[data.draw(st.integers(0, len(seed) - 1))] = data.draw(st.integers(0, 255))
    module.target(bytes(seed) + data.draw(st.binary(max_size=60)))
