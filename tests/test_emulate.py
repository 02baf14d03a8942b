"""The example robots in front of their emulated devices, as people without hardware try them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from paths import REPO

from amr_slam.cli import main


@contextmanager
def emulated(config: str, folder: Path) -> Iterator[None]:
    command = [sys.executable, str(REPO / "tools/emulate.py"), config, "--seconds", "100"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert "its devices are there" in process.stdout.readline()
            yield
        finally:
            process.terminate()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(REPO / "config", tmp_path / "config")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("sick_s300_request", "mode request, baud rate 9600, beams 541"),
        ("sick_lms5xx", "beams 1141 from -5 to 185 deg"),
        ("sick_nanoscan3", "mode stream"),
    ],
)
def test_an_example_robot_is_probed(
    folder: Path, name: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told = ""
    with emulated(f"config/{name}.toml", folder):
        # A robot in real time stumbles where other tests take the processors.
        for _ in range(4):
            status = main(["check", "--config", f"config/{name}.toml", "--probe"])
            told = capsys.readouterr().out
            if status == 0:
                break
    assert status == 0, told
    front = next(line for line in told.splitlines() if line.startswith("front:"))
    assert said in front
    assert "beams measure, nearest" in front
    assert "Hz" in front


@pytest.mark.parametrize("name", ["sick_s300", "sick_tim", "sick_microscan3"])
def test_devices_that_are_not_there_are_named_and_the_status_is_1(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", "--config", f"config/{name}.toml", "--probe"]) == 1
    assert "front: NOT THERE: " in capsys.readouterr().out


def test_what_cannot_be_emulated_is_refused_in_one_line(folder: Path) -> None:
    config = folder / "config/mock.toml"
    config.write_text(
        (folder / "config/sick_tim.toml")
        .read_text()
        .replace('driver = "sick_cola"', 'driver = "mock"')
        .replace('host = "127.0.0.1" ', "#")
        .replace("port = 21123 ", "#")
        .replace('delivery = "streamed"', "#")
        .replace("range_max_m = 25.0", "#")
    )
    done = subprocess.run(
        [sys.executable, str(REPO / "tools/emulate.py"), str(config)],
        cwd=folder, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.strip() == (
        "driver mock has no emulator; there are sick_cola, sick_s300, sick_safety"
    )
