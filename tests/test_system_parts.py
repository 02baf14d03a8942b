"""What the system test is made of, as far as no machine is needed: `make system-test` has that."""

from __future__ import annotations

import runpy
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from paths import REPO
from system import drive
from system.cases import CASES
from system.power_cut import _found

from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.sick_s300.driver import open_scanner
from amr_drivers.sick_s300.settings import Settings
from amr_slam.map import PointMap, save_map
from amr_slam.params import SlamParams


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("drive") / "drive.bin"
    drive.record(file, 6.0)
    return file


def test_a_recorded_drive_has_what_devices_say_in_order(recorded: Path) -> None:
    content, at, times, kinds = recorded.read_bytes(), 0, [], []
    while at < len(content):
        ms, kind, length = drive.PIECE.unpack_from(content, at)
        at += drive.PIECE.size + length
        times.append(ms)
        kinds.append(kind)
    assert at == len(content)
    assert times == sorted(times)
    assert kinds.count(drive.TRUTH) == 300
    assert kinds.count(drive.CAN) == 301  # and where they stood at the start
    assert kinds.count(drive.FRONT) in (2, 3)
    rows = drive.truth(recorded)
    assert rows.shape == (300, 4)
    assert np.all(np.diff(rows[:, 0]) > 0.0)
    assert np.hypot(*(rows[-1, 1:3] - rows[0, 1:3])) > 0.5


def test_a_recorded_scanner_is_understood_by_the_driver(recorded: Path, tmp_path: Path) -> None:
    content, at = recorded.read_bytes(), 0
    line = PtyLine(tmp_path / "scanner")
    scanner = open_scanner("front", Settings(port=line.port))
    try:
        while at < len(content):
            _, kind, length = drive.PIECE.unpack_from(content, at)
            at += drive.PIECE.size + length
            if kind == drive.FRONT:
                line.write(content[at - length : at])
                scan = scanner.read(20.0)
                assert scan is not None
                assert len(scan.ranges_m) == 541
    finally:
        scanner.close()
        line.unplug()


def test_the_agent_answers_with_status_output_and_times() -> None:
    agent = runpy.run_path(str(REPO / "tests/system/guest/agent.py"))
    done = agent["_answer"]({"run": "echo said; exit 3", "limit_s": 60.0})
    assert (done["status"], done["output"]) == (3, "said\n")
    assert done["began_s"] <= done["ended_s"]
    late = agent["_answer"]({"run": "echo said; sleep 100 | cat", "limit_s": 1.0})
    assert (late["status"], late["output"]) == (None, "said\n")


def test_cases_have_names_of_their_own() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)
    assert names[1] == "start"


@pytest.mark.skipif(
    None in map(shutil.which, ("qemu-img", "mke2fs", "debugfs")), reason="needs qemu-img, e2fsprogs"
)
def test_a_map_is_found_on_a_disk_whose_power_was_cut(tmp_path: Path) -> None:
    content = tmp_path / "content/cut"
    save_map(PointMap(SlamParams().map, "save 17"), content / "hall.amrmap")

    def disk() -> None:
        raw = tmp_path / "disk.ext4"
        raw.unlink(missing_ok=True)
        make = ["mke2fs", "-q", "-t", "ext4", "-d", str(content.parent), str(raw), "8m"]
        subprocess.run(make, check=True)
        convert = ["qemu-img", "convert", "-O", "qcow2", str(raw), str(tmp_path / "state.qcow2")]
        subprocess.run(convert, check=True)

    disk()
    assert _found(tmp_path) == ("17", False)
    (content / ".hall.amrmap.99.tmp").write_bytes(b"half")
    (content / "hall.amrmap").write_bytes((content / "hall.amrmap").read_bytes()[:-1])
    disk()
    assert _found(tmp_path) == (None, True)
