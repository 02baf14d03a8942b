"""The driver of docs/drivers/example, as third parties run the suite on theirs."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from paths import REPO
from suite_runs import assert_passes

from amr_drivers import registry
from amr_drivers.conformance import table
from amr_drivers.conformance.scenarios import SCENARIOS

EXAMPLE = REPO / "docs/drivers/example"


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the example were installed: its entry points are those of its pyproject.toml."""
    groups = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]["entry-points"]
    points = {
        group: [EntryPoint(name, value, group) for name, value in entries.items()]
        for group, entries in groups.items()
    }
    for module in (registry, table):
        monkeypatch.setattr(module, "entry_points", lambda group: points.get(group, []))


@pytest.mark.usefixtures("installed")
def test_the_example_is_found_by_its_entry_points() -> None:
    assert "acme_lidar" in registry.scanner_names()
    module = registry.scanner_module("acme_lidar")
    assert module.Settings().port == 4711
    assert "acme_lidar" in table.all_rigs()


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_example_passes_every_scenario(scenario: str, tmp_path: Path) -> None:
    assert_passes(scenario, table.rigs_named(["acme"])["acme_lidar"], tmp_path)


def test_the_command_runs_a_rig_by_module_and_function(tmp_path: Path) -> None:
    page = tmp_path / "faults.md"
    command = "amr_drivers.conformance acme_lidar_rig:rigs --effort quick --only standby --write"
    done = subprocess.run(
        [sys.executable, "-m", *command.split(), str(page)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(EXAMPLE)])},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("passed  acme_lidar: standby: detected in 0.")
    assert "## acme_lidar" in page.read_text()
    assert "| standby | 0." in page.read_text()


def test_names_that_are_no_rigs_are_one_clear_error() -> None:
    with pytest.raises(ValueError, match="no rig is named 'sock'; known are sick_cola"):
        table.rigs_named(["sock"])
    with pytest.raises(ValueError, match="rigs 'acme_lidar:rigs' cannot be loaded"):
        table.rigs_named(["acme_lidar:rigs"])
