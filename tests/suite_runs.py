"""A scenario of the conformance suite as a test."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from amr_drivers.conformance.rig import MakeRig
from amr_drivers.conformance.scenarios import SCENARIOS

ATTEMPTS: Final = 3
"""A limit of time may be broken by a busy machine, but not each time; anything else, never."""


def assert_passes(scenario: str, make: MakeRig, folder: Path) -> None:
    for attempt in range(ATTEMPTS):
        own = folder / str(attempt)
        own.mkdir()
        figures = SCENARIOS[scenario](make, own, "quick")
        assert figures.breaches == ()
        assert figures.false == 0
        if not figures.late:
            return
    assert figures.late == ()
