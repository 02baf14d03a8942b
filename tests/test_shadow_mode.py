"""Shadow mode in the daemon, over real sessions: cameras that are right, wrong and malicious."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
from daemon_rig import Daemon, Robot
from test_commands import Controller
from test_publishing import session

from amr_slam.aligning import read_pairs
from amr_slam.wire import PoseMessage, StatusMessage

KEY = "ceiling/amr7/pose"
SHADOW = """
[shadow]
key = "ceiling/*/pose"
x = "pose.x"
y = "pose.y"
theta = "pose.theta_deg"
stamp = "time_ms"
robot = "robot"
length_unit = "mm"
angle_unit = "deg"
time_unit = "ms"
directory = "{folder}/shadow"
file_period_s = 0.0
"""
BESIDE_M = 0.5


@contextmanager
def cameras(endpoint: str) -> Iterator[zenoh.Session]:
    """See the robot where it says it is, half a metre beside, until the end."""
    stop = threading.Event()

    def seen(sample: zenoh.Sample) -> None:
        if stop.is_set():
            return
        pose = PoseMessage.decode(sample.payload.to_bytes())
        said: dict[str, Any] = {
            "robot": "amr7",
            "time_ms": 1e3 * pose.stamp,
            "pose": {
                "x": 1e3 * pose.x,
                "y": 1e3 * (pose.y + BESIDE_M),
                "theta_deg": 57.29577951308232 * pose.theta,
            },
        }
        opened.put(KEY, json.dumps(said).encode())

    with session("client", connect=[endpoint]) as opened:
        opened.declare_subscriber("amr/amr7/pose", seen)
        yield opened
        stop.set()


@pytest.mark.timeout(300)
def test_differences_are_told_and_nothing_else_changes(tmp_path: Path) -> None:
    more = SHADOW.format(folder=tmp_path)
    with Robot(tmp_path), Daemon(tmp_path, edit=lambda text: text + more) as daemon:
        daemon.listen()
        daemon.status_when(lambda s: s.state == "mapping", "mapping")
        daemon.status_when(lambda s: s.shadow is not None and s.shadow.count == 0, "silent cameras")
        with cameras(daemon.endpoint) as opened:

            def compared(status: StatusMessage) -> bool:
                return status.shadow is not None and status.shadow.count >= 100

            told = daemon.status_when(compared, "a hundred differences").shadow
            assert told is not None
            assert told.key == "ceiling/*/pose"
            assert told.mean_m == pytest.approx(BESIDE_M, abs=0.01)
            assert told.bias_y_m == pytest.approx(BESIDE_M, abs=0.01)
            assert told.bias_rad == pytest.approx(0.0, abs=0.01)
            assert told.refused == 0

            for nonsense in (b"", b"nonsense", b'{"robot": "amr7", "pose": {"x": 1e999}}'):
                opened.put(KEY, nonsense)
            opened.put(KEY, b" " * 100_000)

            def refused(status: StatusMessage) -> bool:
                return status.shadow is not None and status.shadow.refused >= 4

            told = daemon.status_when(refused, "four refused").shadow
            assert told is not None
            assert told.detail is not None
            before = told.count
            opened.put("ceiling/other/pose", json.dumps({"robot": "amr8"}).encode())
            opened.put(KEY, b" " * 2_000_000)  # more than the robot takes in from anybody

            def goes_on(status: StatusMessage) -> bool:
                return status.shadow is not None and status.shadow.count >= before + 100

            daemon.status_when(goes_on, "differences go on")
            poses = daemon.next_poses(100)
            assert {b.seq - a.seq for a, b in itertools.pairwise(poses)} == {1}

            # A robot that has to find itself in its map is compared from then on.
            controller = Controller(opened)
            controller.done("save_map", name="finished")
            controller.done("load_map", name="finished")

            def located(status: StatusMessage) -> bool:
                return (status.mode, status.state) == ("localization", "localized")

            there = daemon.status_when(located, "localized").shadow
            assert there is not None
            assert there.unlocalized > told.unlocalized

            def compared_there(status: StatusMessage) -> bool:
                return status.shadow is not None and status.shadow.count >= there.count + 100

            told = daemon.status_when(compared_there, "a hundred differences there").shadow
            assert told is not None
            assert told.mean_m == pytest.approx(BESIDE_M, abs=0.01)
        assert "shadow, ceiling/*/pose: " in daemon.log()
        assert daemon.stop() == 0
    pairs = read_pairs(tmp_path / "shadow" / "amr7-shadow.csv")
    assert len(pairs) >= 200
    assert pairs.has_headings
    assert pairs.twists is not None
