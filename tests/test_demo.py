"""``make demo`` as its users run it: processes, pseudo-terminals, CAN frames and Zenoh."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil  # type: ignore[import-untyped]  # comes without types
import pytest
from paths import REPO

PORTS = {"can", "scanner-front", "scanner-rear"}
DEADLINE_S = 60.0


class Demo:
    """The demo, its output as it comes, and all processes that belong to it."""

    def __init__(self, out: Path, seconds: int) -> None:
        self.out = out
        command = [sys.executable, "tools/demo.py", "--seconds", str(seconds), "--out", str(out)]
        self.process = subprocess.Popen(
            command, cwd=REPO, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.family: list[psutil.Process] = []

    def wait_until_driving(self) -> None:
        """The first pose is printed; then all processes are there."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if "within" in line:
                break
        self.family = psutil.Process(self.process.pid).children(recursive=True)
        assert len(self.family) >= 2
        assert set(os.listdir(self.out)) >= PORTS

    def finish(self) -> tuple[int, str, str]:
        """(exit status, rest of the output, errors); nothing may be left of it."""
        output, errors = self.process.communicate(timeout=DEADLINE_S)
        _, alive = psutil.wait_procs(self.family, timeout=10.0)
        assert alive == []
        assert not PORTS & set(os.listdir(self.out))
        return self.process.returncode, output, errors


@pytest.fixture
def out(tmp_path: Path) -> Iterator[Path]:
    yield tmp_path / "demo"
    # Whatever a failed test leaves behind must not disturb the next ones.
    for process in psutil.process_iter(["cmdline"]):
        if any(str(tmp_path) in word for word in process.info["cmdline"] or []):
            process.kill()


def test_the_whole_way(out: Path) -> None:
    demo = Demo(out, 10)
    demo.wait_until_driving()
    status, output, errors = demo.finish()
    assert (status, errors) == (0, "")
    assert "wrong without saying so: 0 of" in output
    results = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    # A busy test machine may cost poses and centimetres; the demo's own goals are much closer.
    assert results["poses"] > 300
    assert results["position_m"]["rms"] < 0.1
    assert results["heading_deg"]["rms"] < 2.0
    assert results["wrong_silently"] == 0
    assert (out / "demo.amrmap").stat().st_size > 0
    assert (out / "map.png").read_bytes().startswith(b"\x89PNG")


def test_interrupted_it_leaves_nothing_behind(out: Path) -> None:
    demo = Demo(out, 600)
    demo.wait_until_driving()
    demo.process.send_signal(signal.SIGINT)
    status, _, errors = demo.finish()
    assert status == 130
    assert "Traceback" not in errors


def test_a_daemon_that_dies_fails_the_demo(out: Path) -> None:
    demo = Demo(out, 600)
    demo.wait_until_driving()
    (daemon,) = (p for p in demo.family if "run" in p.cmdline() and "--config" in p.cmdline())
    begin_s = time.monotonic()
    daemon.kill()
    status, _, errors = demo.finish()
    assert time.monotonic() - begin_s < DEADLINE_S
    assert status == 1
    assert errors.startswith("demo: the daemon ended with status -9")
