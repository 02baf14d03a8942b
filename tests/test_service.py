from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from daemon_rig import (
    DEADLINE_S,
    ROBOT,
    Daemon,
    Robot,
    environment,
    has_ended,
    until,
    write_config,
)
from labs import cloud_at, room

from amr_slam.cli import main
from amr_slam.geometry import Pose2
from amr_slam.map import MapParams, PointMap, load_map, save_map
from amr_slam.samples import Scan, State
from amr_slam.service import probe
from amr_slam.wire import StatusMessage

POSE_FIELDS = {
    *("v", "robot", "seq", "stamp", "age_s", "map", "epoch", "x", "y", "theta", "vx", "omega"),
    *("covariance", "error95_m", "state", "since_fix_s", "since_fix_m", "odom", "fault"),
}


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with Robot(tmp_path) as robot:
        yield robot


def links(status: StatusMessage) -> dict[str, str]:
    return {name: part.link for name, part in status.health().items()}


def is_well(status: StatusMessage) -> bool:
    return set(links(status).values()) == {"OK"} and status.slam.samples > 0


def without_gap(stamps: list[float]) -> bool:
    """Generous: the machine that runs this may be busy."""
    return max(b - a for a, b in itertools.pairwise(stamps)) < 0.3


def test_poses_status_and_a_clean_stop(robot: Robot, tmp_path: Path) -> None:
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        status = daemon.status_when(is_well, "all is well")
        assert status.mode == "mapping"
        assert status.map is not None
        assert status.map.name == "hall"
        assert status.memory_mb > 10
        assert status.version

        poses = daemon.next_poses(100)
        assert {b.seq - a.seq for a, b in itertools.pairwise(poses)} == {1}
        rate_hz = (len(poses) - 1) / (poses[-1].stamp - poses[0].stamp)
        # The robot lives in this process, and other tests may slow it down; the demo is stricter.
        assert rate_hz == pytest.approx(50.0, rel=0.25)
        assert without_gap([pose.stamp for pose in poses])
        assert poses[-1].state is State.MAPPING
        assert poses[-1].map == status.map.id
        assert sorted(pose.age_s for pose in poses)[len(poses) // 2] < 0.02
        assert poses[-1].stamp == pytest.approx(time.time(), abs=5.0)
        assert all(pose.error95_m < 0.5 for pose in poses)

        answers = answers_of(daemon.endpoint)
        assert set(answers["pose"]) == POSE_FIELDS | {"epoch_delta", "every"}
        assert answers["pose"]["robot"] == ROBOT
        assert answers["status"]["scanners"].keys() == {"front", "rear"}
        assert daemon.fleet is not None
        assert daemon.fleet.views()[ROBOT].alive
        until(lambda: daemon.supervisor.count("WATCHDOG=1") >= 3, "three feedings")

        begun_s = time.monotonic()
        assert daemon.stop() == 0, daemon.log()
        assert time.monotonic() - begun_s < 5.0
        assert daemon.supervisor.count("STOPPING=1") == 1
        assert daemon.fleet.wait_for(lambda views: not views[ROBOT].alive, DEADLINE_S)
        grown, _ = load_map(daemon.map_path)
        assert len(grown.path) >= 1
        assert len(grown) > 200


def answers_of(endpoint: str) -> dict[str, dict[str, Any]]:
    """What ``get`` on the robot's keys gives."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    found = {}
    with zenoh.open(config) as session:
        for topic in ("pose", "status"):
            (reply,) = session.get(f"amr/{ROBOT}/{topic}")
            assert reply.ok is not None
            assert reply.ok.encoding == zenoh.Encoding.APPLICATION_JSON
            found[topic] = json.loads(reply.ok.payload.to_bytes())
    return found


def test_a_scanner_comes_back_and_ctrl_c_saves_the_map(robot: Robot, tmp_path: Path) -> None:
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(is_well, "all is well")
        robot.front.unplug()
        status = daemon.status_when(lambda s: s.scanners["front"].link == "LOST", "front LOST")
        assert links(status) == {"front": "LOST", "rear": "OK", "wheels": "OK", "slam": "OK"}
        assert status.fault is not None
        assert "front lost" in status.fault
        answered = status.slam.samples
        daemon.status_when(lambda s: s.slam.samples > answered, "fixes by the rear scanner")
        assert any("front lost" in (pose.fault or "") for pose in daemon.next_poses(20))
        robot.front.replug()
        daemon.status_when(is_well, "front is back")
        # The link is back at once, the scanner takes part with its next scan.
        daemon.status_when(lambda s: s.fault is None, "no fault any more")
        assert daemon.log().count("WARNING amr_slam.service.devices: front") == 1
        assert without_gap([pose.stamp for pose in daemon.waiting_poses()])
        # Ctrl-C at a terminal reaches all processes.
        assert daemon.stop(signal.SIGINT, group=True) == 130
        assert len(load_map(daemon.map_path)[0].path) >= 1
        assert "Traceback" not in daemon.log()


def test_scanners_that_freeze_or_are_mirrored_are_named_and_come_back(
    robot: Robot, tmp_path: Path
) -> None:
    first: list[Scan] = []

    def rear_frozen(scan: Scan) -> Scan:
        if scan.scanner == "rear":
            first.append(scan)
        return first[0] if scan.scanner == "rear" else scan

    def rear_mirrored(scan: Scan) -> Scan:
        return replace(scan, ranges_m=scan.ranges_m[::-1]) if scan.scanner == "rear" else scan

    with Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(is_well, "all is well")
        for disturb, named in (
            (rear_frozen, "rear scanner frozen"),
            (rear_mirrored, "scanner configuration: rear scanner looks mirrored"),
        ):
            robot.disturb = disturb
            daemon.status_when(lambda s, text=named: text in (s.fault or ""), named)  # type: ignore[misc]
            robot.disturb = lambda scan: scan
            daemon.status_when(lambda s: is_well(s) and s.fault is None, "all is well again")
        status = daemon.status_when(lambda s: s.state is State.MAPPING, "mapping")
        assert status.outcomes["scan.frozen"] > 0
        assert status.outcomes["fix.mismounted"] >= 3
        assert daemon.stop() == 0


@pytest.mark.parametrize(
    ("number", "reason", "goes_on_with"),
    [
        (signal.SIGKILL, "killed by SIGKILL", "hall.amrmap"),
        (signal.SIGSTOP, "no answer within 2 s", "scans since it was saved"),
    ],
    ids=["killed", "hung"],
)
def test_poses_go_on_while_the_slam_process_is_replaced(
    robot: Robot, tmp_path: Path, number: signal.Signals, reason: str, goes_on_with: str
) -> None:
    with Daemon(tmp_path, save_period_s=5.0, answer_limit_s=2.0) as daemon:
        daemon.listen()
        before = daemon.status_when(
            lambda s: is_well(s) and s.map is not None and s.map.version >= 2, "a map of two scans"
        )
        if number == signal.SIGKILL:
            until(lambda: "saved to" in daemon.log(), "the first save")
        first = daemon.slam_process()
        daemon.waiting_poses()
        os.kill(first, number)
        status = daemon.status_when(lambda s: s.slam.link == "LOST", "slam LOST")
        assert status.fault is not None
        assert reason in status.fault
        answered = status.slam.samples
        status = daemon.status_when(
            lambda s: is_well(s) and s.slam.samples > answered and s.fault is None, "slam is back"
        )
        assert daemon.slam_process() != first
        assert status.slam.errors == 1
        assert goes_on_with in (status.slam.detail or "")
        assert before.map is not None
        assert status.map is not None
        # All of it: what was on disk, and what had joined the map since.
        assert status.map.version >= before.map.version
        seen = daemon.waiting_poses()
        assert any(reason in (pose.fault or "") for pose in seen)
        assert without_gap([pose.stamp for pose in seen])
        assert {b.seq - a.seq for a, b in itertools.pairwise(seen)} == {1}
        assert len({pose.epoch for pose in seen}) == 1
        assert daemon.stop() == 0
        assert len(load_map(daemon.map_path)[0].path) >= status.map.version


def test_missing_devices_are_waited_for_and_the_slam_process_outlives_nobody(
    tmp_path: Path,
) -> None:
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        status = daemon.status_when(lambda s: s.slam.link == "OK", "slam is up")
        assert links(status) == {"front": "LOST", "rear": "LOST", "wheels": "LOST", "slam": "OK"}
        assert status.state is State.STARTING
        with Robot(tmp_path):
            status = daemon.status_when(is_well, "the devices are there")
        status = daemon.status_when(lambda s: s.wheels.link == "LOST", "they are gone again")
        assert daemon.fleet is not None
        daemon.status_when(lambda s: s.state is State.LOST, "nothing is known any more")
        # Without wheels the poses go on and say so.
        before = daemon.fleet.views()[ROBOT].pose
        assert before is not None
        seq = before.seq
        assert daemon.fleet.wait_for(
            lambda views: (pose := views[ROBOT].pose) is not None and pose.seq > seq + 50,
            DEADLINE_S,
        )
        last = daemon.fleet.views()[ROBOT].pose
        assert last is not None
        assert last.age_s > 1.0
        assert last.state is State.LOST
        assert "wheels" in (last.fault or "")
        worker = daemon.slam_process()
        assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
        until(lambda: has_ended(worker), "the worker's end")
        assert len(load_map(daemon.map_path)[0].path) >= 1


BROKEN = """
import dataclasses
@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    reason: str = ""
def open_scanner(name, settings, tap):
    if settings.reason:
        raise ValueError(settings.reason)
    raise KeyError("a fault of the program")
"""
WITH_BROKEN = """
import sys
from amr_drivers import registry
from amr_slam.cli import main
registry._SCANNERS["broken"] = "broken"
sys.exit(main(["run", "--config", sys.argv[1]]))
"""


@pytest.mark.parametrize(
    ("options", "status", "line"),
    [
        ("{}", 1, "RuntimeError: front: the driver has failed"),
        ('{ reason = "no such beam" }', 2, "scanners[0].options: no such beam"),
    ],
    ids=["fault", "unusable"],
)
def test_a_driver_that_fails_as_none_may_ends_all(
    tmp_path: Path, options: str, status: int, line: str
) -> None:
    (tmp_path / "broken.py").write_text(BROKEN)
    config = tmp_path / "robot.toml"
    config.write_text(
        '[robot]\nname = "amr7"\n[drive]\nkind = "differential"\nradius_left_m = 0.1\n'
        'radius_right_m = 0.1\ntrack_m = 0.5\n[odometry]\ndriver = "mock"\n[[scanners]]\n'
        f'name = "front"\ndriver = "broken"\noptions = {options}\n'
        "mounting = { x_m = 0.0, y_m = 0.0, theta_deg = 0.0 }\n"
        f'[map]\nmode = "mapping"\ndirectory = "{tmp_path}"\n[zenoh]\nlisten = []\n'
    )
    ended = subprocess.run(
        [sys.executable, "-c", WITH_BROKEN, str(config)],
        check=False,
        env=environment(PYTHONPATH=str(tmp_path)),
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
    )
    assert ended.returncode == status, ended.stderr
    assert line in ended.stderr.splitlines()[-1]
    assert ("KeyError: 'a fault of the program'" in ended.stderr) == (status == 1)


@pytest.mark.parametrize("command", ["run", "check"])
def test_an_unknown_key_is_one_line_and_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    config = tmp_path / "robot.toml"
    config.write_text('[robot]\nname = "amr7"\ncolour = "red"\n')
    assert main([command, "--config", str(config)]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    (line,) = told.err.splitlines()
    assert f"{config}: robot.colour: unknown key" in line


def test_a_probe_says_what_is_there_and_what_is_not(
    robot: Robot,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(probe, "PROBE_S", 2.0)
    config = write_config(tmp_path)
    robot.rear.unplug()
    robot.front.mode = "lock-out"
    assert main(["check", "--config", str(config), "--probe"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert f"{config}: robot amr7, mapping" in lines
    seen = {line.partition(":")[0]: line for line in lines[-3:]}
    assert "NOT WELL: lock-out" in seen["front"]
    assert "SICK S300" in seen["front"]
    assert "rear: NOT THERE: " in seen["rear"]
    assert "wheels: wheel encoders on slcan" in seen["wheels"]
    assert "NOT" not in seen["wheels"]
    assert " 0.00 rad" not in seen["wheels"]


def test_a_damaged_map_is_refused_and_a_good_one_is_taken_when_it_comes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hall.amrmap"
    path.write_bytes(b"AMRMAP\r\n" + bytes(100))
    with Daemon(tmp_path, localize=True) as daemon:
        assert main(["check", "--config", str(daemon.config)]) == 2
        assert "map.path" in capsys.readouterr().err
        # A robot that nobody logs into says so where the fleet hears it.
        daemon.listen()
        status = daemon.status_when(lambda s: "hall.amrmap" in (s.fault or ""), "the map's fault")
        assert status.map is None
        assert status.state is State.STARTING
        assert status.slam.link == "LOST"
        grown = PointMap(MapParams(), "hall")
        grown.insert(
            cloud_at(room(), Pose2(4.0, 3.0, 0.0), np.random.default_rng(1)), Pose2(4, 3, 0)
        )
        save_map(grown, path)
        status = daemon.status_when(lambda s: s.map is not None, "the map that was brought")
        assert daemon.stop() == 0


def test_an_older_version_stands_in_for_a_damaged_map_and_that_is_said(tmp_path: Path) -> None:
    path = tmp_path / "hall.amrmap"
    for x_m in (4.0, 4.5):
        grown = PointMap(MapParams(), "hall")
        pose = Pose2(x_m, 3.0, 0.0)
        grown.insert(cloud_at(room(), pose, np.random.default_rng(1)), pose)
        save_map(grown, path)
    good = load_map(tmp_path / "hall.amrmap.1")[1]
    path.write_bytes(path.read_bytes()[:-1])
    with Daemon(tmp_path, localize=True) as daemon:
        daemon.listen()
        status = daemon.status_when(lambda s: s.map is not None, "a map")
        assert status.map is not None
        assert status.map.id == str(good)
        daemon.status_when(
            lambda s: "using hall.amrmap.1, an older map" in (s.fault or ""), "that it is said"
        )
        assert daemon.stop() == 0
