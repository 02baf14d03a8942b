"""The fuzz targets of the safety scanners' parsers on inputs that hypothesis makes of the seeds."""

from __future__ import annotations

from types import ModuleType

import pytest
from fuzz import cola2, ms3_datagrams
from hypothesis import given, settings
from hypothesis import strategies as st


@pytest.mark.parametrize("module", [cola2, ms3_datagrams], ids=["cola2", "ms3_datagrams"])
def test_seeds_pass(module: ModuleType) -> None:
    for seed in module.seeds():
        module.target(seed)
        for length in range(len(seed)):
            module.target(seed[:length])


@pytest.mark.parametrize("module", [cola2, ms3_datagrams], ids=["cola2", "ms3_datagrams"])
@settings(derandomize=True, deadline=None, max_examples=300)
@given(data=st.data())
def test_mutants_of_seeds_pass(module: ModuleType, data: st.DataObject) -> None:
    seed = bytearray(data.draw(st.sampled_from(module.seeds())))
    for _ in range(data.draw(st.integers(0, 4))):
        at = data.draw(st.integers(0, len(seed)))
        piece = data.draw(st.binary(max_size=6))
        seed[at : at + data.draw(st.integers(0, 6))] = piece
    module.target(bytes(seed))
