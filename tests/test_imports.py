from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EDGES = ("serial", "can", "cantools", "zenoh", "pydantic", "matplotlib", "socketserver")
HEAVY = (
    "numpy",
    "scipy",
    "filterpy",
    "numba",
    "matplotlib",
    "can",
    "serial",
    "cryptography",
    "rich",
)


def loaded_with(module: str) -> set[str]:
    """In a process of its own: this one has loaded everything already."""
    code = f"import sys, {module}; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert set(module.split(", ")) <= loaded
    return loaded


@pytest.mark.parametrize("module", ["amr_slam.localizer", "amr_slam.engine"])
def test_the_core_opens_no_device_and_knows_no_network(module: str) -> None:
    loaded = loaded_with(module)
    assert not loaded & set(EDGES)
    assert not [name for name in loaded if name.startswith(("amr_drivers", "amr_slam.simulation"))]


def test_further_encodings_are_pure() -> None:
    loaded = loaded_with("amr_slam.encodings.ros2")
    assert not loaded & {"zenoh", "rosbags", "serial", "can", "matplotlib"}
    assert not [name for name in loaded if name.startswith(("amr_drivers", "amr_slam.config"))]


@pytest.mark.parametrize("module", ["amr_slam.wire", "amr_slam.client"])
def test_controllers_need_none_of_the_robots_libraries(module: str) -> None:
    loaded = loaded_with(module)
    assert "pydantic" in loaded
    assert not loaded & set(HEAVY)


def test_the_slam_process_is_started_before_anything_heavy() -> None:
    assert not loaded_with("amr_slam.cli, amr_slam.starting") & set(HEAVY)


def test_a_daemons_start_loads_no_numerics_that_only_its_slam_process_uses() -> None:
    unused = ("scipy.spatial", "scipy.sparse", "scipy.ndimage", "scipy.stats", "matplotlib.pyplot")
    assert not loaded_with("amr_slam.service.daemon") & {*unused, "numba", "llvmlite"}


@pytest.mark.parametrize("command", ["run", "check", "doctor"])
def test_what_is_wrong_in_a_configuration_is_said_before_anything_heavy_is_imported(
    command: str, tmp_path: Path
) -> None:
    """A start that fails tells so within a second; what takes seconds comes after it."""
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("[robot]\nname = 7\n")
    code = (
        "import sys; from amr_slam.cli import main\n"
        f"status = main([{command!r}, '--config', {str(wrong)!r}])\n"
        "print(status, *sorted(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    status, *loaded = done.stdout.splitlines()[-1].split()
    said = done.stdout if command == "doctor" else done.stderr
    assert status == ("1" if command == "doctor" else "2")
    assert "robot.name: should be a valid string, not 7" in said
    unused = {"numba", "scipy.spatial", "scipy.sparse", "matplotlib", "rich", "serial", "can"}
    assert not set(loaded) & {*unused, "amr_slam.service.daemon", "amr_slam.service.probe"}


def test_the_command_line_alone_imports_nothing_of_a_command() -> None:
    loaded = loaded_with("amr_slam.cli")
    assert not loaded & {*HEAVY, "zenoh", "pydantic", "amr_slam.config"}
