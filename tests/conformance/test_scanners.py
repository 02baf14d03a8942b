from __future__ import annotations

from pathlib import Path

import pytest

from amr_drivers.conformance.scenarios import SCENARIOS
from amr_drivers.conformance.table import all_rigs


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("rig", all_rigs())
def test_every_driver_passes_every_scenario(rig: str, scenario: str, tmp_path: Path) -> None:
    figures = SCENARIOS[scenario](all_rigs()[rig], tmp_path, "quick")
    assert figures.breaches == ()
    assert figures.false == 0
