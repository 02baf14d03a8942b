from __future__ import annotations

import contextlib
import io
import json
import math
import os
import signal
import subprocess
import sys
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amr_slam.cli import fleet, main, progress
from amr_slam.cli.arguments import MODULES
from amr_slam.client import SessionError
from amr_slam.config import Config
from amr_slam.map import PointMap, load_map, save_map
from amr_slam.params import SlamParams
from amr_slam.recording import RecordingWriter, read_log, read_tum
from amr_slam.samples import Scan, WheelSample
from amr_slam.service import daemon, probe
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Vehicle,
    laboratory,
    opposite_scanners,
    plan_tour,
    take_scan,
)
from amr_slam.starting import Started
from amr_slam.wire import DEFAULT_ENDPOINT

CONFIG = """
robot = { name = "simulated" }
odometry = { driver = "mock" }
map = { mode = "mapping" }
[drive]
kind = "differential"
radius_left_m = 0.1
radius_right_m = 0.1
track_m = 0.5
[[scanners]]
name = "front"
driver = "mock"
mounting = { x_m = 0.24, y_m = 0.2, theta_deg = 45.0 }
[[scanners]]
name = "rear"
driver = "mock"
mounting = { x_m = -0.24, y_m = -0.2, theta_deg = -135.0 }
"""
FIELDS = {
    "stamp", "accepted", "x", "y", "theta", "covariance", "error95_m", "score", "ambiguity",
    "second", "reason", "elapsed_s",
}  # fmt: skip


@dataclass(frozen=True)
class Done:
    status: int
    out: str
    err: str


def amr_slam(*arguments: object) -> Done:
    """In this process, which is quicker."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main(list(map(str, arguments)))
        except SystemExit as ended:
            status = int(ended.code or 0)
    return Done(status, out.getvalue(), err.getvalue())


def amr_slam_process(*arguments: object) -> Done:
    """As people start it."""
    ran = subprocess.run(
        [sys.executable, "-m", "amr_slam", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return Done(ran.returncode, ran.stdout, ran.stderr)


def error_line(done: Done) -> str:
    """The only line on standard error, without its beginning."""
    lines = done.err.splitlines()
    assert len(lines) == 1, done.err
    assert lines[0].startswith("amr-slam: error: ")
    assert done.out == ""
    return lines[0].removeprefix("amr-slam: error: ")


@dataclass(frozen=True)
class Hall:
    """A recording of two scanners, a CARMEN log of one, and the map of the recording."""

    config: Path
    log: Path
    carmen: Path
    map: Path


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Hall:
    folder = tmp_path_factory.mktemp("hall")
    hall = Hall(folder / "robot.toml", folder / "run.mcap", folder / "run.log", folder / "a.amrmap")
    hall.config.write_text(CONFIG)
    world = laboratory(3)
    tour = plan_tour(world)
    robot = SimulatedRobot(
        world=world,
        world_from_map=tour.world_from_map,
        scanners=opposite_scanners(ScannerModel(sigma_range_m=0.01)),
        vehicle=Vehicle(left_radius_error=0.01),
        scan_period_s=1.0,
        seed=3,
    )
    follower = PathFollower(tour.path_in_map_m)
    with RecordingWriter(hall.log) as writer:
        while robot.stamp_ns < 10_000_000_000:
            for sample in robot.advance(*follower.steer(robot.map_from_base)):
                writer.write(sample)
            writer.write_truth(robot.stamp_ns, robot.map_from_base)
    hall.carmen.write_text(carmen_log())
    done = amr_slam("replay", hall.log, "--config", hall.config, "--map-out", hall.map)
    assert done.status == 0, done.err
    return hall


def carmen_log() -> str:
    """The same laboratory, a robot that stands at the origin and counts nothing."""
    world = laboratory(3)
    model = ScannerModel(beams=181, angle_min_rad=-math.pi / 2, angle_step_rad=math.radians(1.0))
    start = plan_tour(world).world_from_map
    rng = np.random.default_rng(1)
    lines = ["# one line of each kind"]
    for second in range(4):
        scan = take_scan(model, world, start, rng)
        ranges = " ".join(f"{r:.2f}" for r in np.nan_to_num(scan.ranges_m, posinf=81.91))
        lines.append(f"ODOM 0 0 0 0 0 0 {second}.0 host {second}.0")
        lines.append(f"FLASER 181 {ranges} 0 0 0 0 0 0 {second}.5 host {second}.5")
    lines.append("ODOM 0 0 0 0 0 0 9.0 host 9.0")
    return "\n".join(lines) + "\n"


# -- help --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [["run"], ["check"], ["replay"], ["localize"], ["map"], ["map", "info"], ["map", "render"],
     ["map", "export"], ["map", "import"], ["map", "edit"], ["map", "report"], ["map", "diff"],
     ["map", "accept"], ["map", "rollback"], ["watch"], ["view"], ["foxglove"], ["call"]],
)  # fmt: skip
def test_help_shows_an_example_of_the_command(command: list[str]) -> None:
    done = amr_slam(*command, "--help")
    assert done.status == 0
    said = " ".join(done.out.split())
    assert f"example: amr-slam {' '.join(command)} " in said


def test_help_and_refusals_load_nothing_heavy() -> None:
    code = (
        "import sys\nfrom amr_slam.cli import main\n"
        "for argv in (['--help'], ['replay', '--help'], ['replay', '--bogus']):\n"
        "    try: main(argv)\n"
        "    except SystemExit: pass\n"
        "assert not {'numpy', 'scipy', 'zenoh', 'matplotlib'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, timeout=60)


def test_the_localizer_needs_no_pictures() -> None:
    code = "import sys, amr_slam.localizer\nassert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


# -- replay ------------------------------------------------------------------------------------


def test_replay_writes_poses_map_and_report(hall: Hall, tmp_path: Path) -> None:
    done = amr_slam(
        "replay", hall.log, "--config", hall.config, "--scan-period", "2.0",
        "--out", tmp_path / "online.tum", "--out-final", tmp_path / "final.tum",
        "--map-out", tmp_path / "new.amrmap", "--report", tmp_path / "report.json",
    )  # fmt: skip
    assert (done.status, done.err) == (0, "")
    log = read_log(hall.log)
    assert log.truth is not None
    wheels = [s.stamp_ns for s in log.samples if isinstance(s, WheelSample)]
    online, final = read_tum(tmp_path / "online.tum"), read_tum(tmp_path / "final.tum")
    assert online.stamps_ns.tolist() == final.stamps_ns.tolist() == wheels
    offset = final.poses[1:, :2] - log.truth.poses[:, :2]
    assert np.hypot(*offset.T).max() < 0.05
    grown, map_id = load_map(tmp_path / "new.amrmap")
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["map"]["uuid"] == str(map_id)
    assert report["map"]["scans"] == len(grown.path) == 5
    assert (report["scans_in_log"], report["scans_used"]) == (20, 10)
    assert len(report["scans"]) == report["registrations"] == 5
    # All but the founding scan are registered.
    assert sum(counts.get("accepted", 0) for counts in report["answers"].values()) == 4
    assert report["final_state"] == "mapping"
    assert report["truth"]["final"]["position_m"]["max"] == pytest.approx(
        np.hypot(*offset.T).max(), abs=1e-5
    )
    assert "run.mcap: 10 s, 501 poses, 10 of 20 scans" in done.out
    assert "registered 5: accepted 4 (" in done.out
    assert "x real time" in done.out


def test_the_same_input_gives_the_same_bytes(hall: Hall, tmp_path: Path) -> None:
    names = ("online.tum", "final.tum", "new.amrmap", "report.json")
    for folder in (tmp_path / "first", tmp_path / "second"):
        folder.mkdir()
        online, final, grown, report = (folder / name for name in names)
        done = amr_slam_process(
            "replay", hall.log, "--config", hall.config, "--out", online, "--out-final", final,
            "--map-out", grown, "--report", report,
        )  # fmt: skip
        assert done.status == 0
    for name in names:
        first = (tmp_path / "first" / name).read_bytes()
        assert first
        assert first == (tmp_path / "second" / name).read_bytes(), name


def test_replay_in_a_map_leaves_it_and_finds_the_way_without_a_start(
    hall: Hall, tmp_path: Path
) -> None:
    before = hall.map.read_bytes()
    report = tmp_path / "report.json"
    done = amr_slam(
        "replay", hall.log, "--config", hall.config, "--map", hall.map, "--report", report
    )
    assert done.status == 0
    said = json.loads(report.read_text())
    assert said["final_state"] == "localized"
    assert said["answers"]["absolute"]["accepted"] >= 2
    assert not any(scan["inserted"] for scan in said["scans"])
    assert said["truth"]["aligned"] is True
    assert hall.map.read_bytes() == before


def test_mapping_goes_on_with_a_map_and_keeps_the_older_version(hall: Hall, tmp_path: Path) -> None:
    target = tmp_path / "hall.amrmap"
    target.write_bytes(hall.map.read_bytes())
    arguments = ["--map", target, "--mapping", "--map-out", target]
    done = amr_slam("replay", hall.log, "--config", hall.config, *arguments)
    assert done.status == 0
    assert len(load_map(target)[0].path) > len(load_map(hall.map)[0].path)
    assert Path(f"{target}.1").read_bytes() == hall.map.read_bytes()
    done = amr_slam("replay", hall.log, "--config", hall.config, *arguments, "--keep", "0")
    assert done.status == 0
    assert Path(f"{target}.1").read_bytes() == hall.map.read_bytes()


def test_a_held_map_grows_on_and_stays_to_the_last_bit(hall: Hall, tmp_path: Path) -> None:
    target = tmp_path / "grown.amrmap"
    arguments = ["--map", hall.map, "--mapping", "--hold", "--map-out", target]
    done = amr_slam("replay", hall.log, "--config", hall.config, *arguments)
    assert (done.status, done.err) == (0, "")
    before, after = load_map(hall.map)[0], load_map(target)[0]
    assert len(after.path) > len(before.path)
    for old, new in ((before.walls, after.walls), (before.space, after.space)):
        np.testing.assert_array_equal(new.sums[new.find(old.keys)], old.sums)
    refused = amr_slam("replay", hall.log, "--config", hall.config, "--hold")
    assert refused.status == 2
    assert error_line(refused) == "--hold needs --map and --mapping: a map that grows on"


def test_a_carmen_log_needs_no_configuration(hall: Hall, tmp_path: Path) -> None:
    out = tmp_path / "out.tum"
    done = amr_slam("replay", hall.carmen, "--lidar", "-0.2,0,180", "--out", out)
    assert (done.status, done.err) == (0, "")
    assert np.abs(read_tum(out).poses).max() < 0.01
    grown = tmp_path / "run.amrmap"
    assert amr_slam("replay", hall.carmen, "--lidar=0,0,0", "--map-out", grown).status == 0
    turned = tmp_path / "turned.amrmap"
    assert amr_slam("replay", hall.carmen, "--lidar", "0,0,90", "--map-out", turned).status == 0
    straight, sideways = (load_map(path)[0].target().points_m for path in (grown, turned))
    # The scanner sees half a circle: ahead of it in one, to the left of it in the other.
    assert straight[:, 0].min() > -0.2
    assert sideways[:, 1].min() > -0.2
    assert load_map(grown)[0].name == "run"


def test_a_lonely_scanner_without_a_mounting_is_said(hall: Hall) -> None:
    done = amr_slam_process("replay", hall.carmen)
    assert done.status == 0
    assert "WARNING" in done.err
    assert "flaser" in done.err


# -- localize ----------------------------------------------------------------------------------


@pytest.mark.parametrize("prior", ["none", "previous"])
def test_localize_says_for_each_scan_where_it_was(hall: Hall, prior: str) -> None:
    done = amr_slam(
        "localize", "--map", hall.map, hall.log, "--config", hall.config, "--prior", prior
    )
    assert done.status == 0
    log = read_log(hall.log)
    assert log.truth is not None
    scans = [sample for sample in log.samples if isinstance(sample, Scan)]
    answers = [json.loads(line) for line in done.out.splitlines()]
    assert len(answers) == len(scans)
    truth_s = log.truth.stamps_ns / 1e9
    for scan, answer in zip(scans, answers, strict=True):
        assert set(answer) == FIELDS
        assert answer["stamp"] == scan.mid_stamp_ns / 1e9
        assert answer["accepted"] is True
        assert answer["reason"] is None
        x, y = (np.interp(answer["stamp"], truth_s, log.truth.poses[:, k]) for k in (0, 1))
        assert math.hypot(answer["x"] - x, answer["y"] - y) < 0.03
        covariance = np.array(answer["covariance"]).reshape(3, 3)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        assert 0.0 < answer["error95_m"] < 0.1
        assert 0.0 <= answer["ambiguity"] < 0.8
        assert 0.5 < answer["score"] <= 1.0
        assert answer["second"] is None or set(answer["second"]) == {"x", "y", "theta", "score"}
        assert answer["elapsed_s"] > 0.0


def test_localize_does_not_accept_what_it_cannot_know(hall: Hall, tmp_path: Path) -> None:
    log, far = tmp_path / "far.mcap", 8.0
    # A round hall, each time of another size: no place and no heading fits.
    with RecordingWriter(log) as writer:
        for index, ranges in enumerate((np.full(181, far), np.full(181, np.inf))):
            scan = Scan(
                scanner="front",
                stamp_ns=index * 1_000_000_000,
                ranges_m=ranges,
                angle_min_rad=-math.pi / 2,
                angle_step_rad=math.radians(1.0),
            )
            writer.write(scan)
    done = amr_slam("localize", "--map", hall.map, log, "--lidar", "0,0,0")
    assert done.status == 0
    unfit, empty = (json.loads(line) for line in done.out.splitlines())
    assert unfit["accepted"] is empty["accepted"] is False
    assert unfit["x"] is not None
    assert unfit["reason"]
    assert (unfit["covariance"], unfit["error95_m"]) == (None, None)
    assert [empty[name] for name in ("x", "y", "theta", "second")] == [None] * 4
    assert (empty["score"], empty["ambiguity"]) == (0.0, 1.0)
    assert empty["reason"] == "the scan is empty"


def test_a_reader_that_leaves_is_no_fault(hall: Hall) -> None:
    command: list[str | Path] = [sys.executable, "-m", "amr_slam", "localize", "--map", hall.map]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [*command, hall.log, "--config", hall.config], stdout=pipe, stderr=pipe
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert json.loads(process.stdout.readline())["accepted"]
        process.stdout.close()
        said = process.stderr.read()
        assert process.wait(timeout=60) == 1
    assert b"Error" not in said


def test_progress_is_shown_on_a_terminal_only(
    hall: Hall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(progress, "PERIOD_S", 0.0)
    terminal = Terminal()
    with contextlib.redirect_stderr(terminal), contextlib.redirect_stdout(io.StringIO()):
        assert main(["replay", str(hall.carmen), "--lidar", "0,0,0"]) == 0
    shown = terminal.getvalue().split("\r\x1b[K")
    assert shown[1].startswith("replay:   0%  0 of 9 s")
    assert shown[-2].startswith("replay: 100%  9 of 9 s")
    assert shown[-1] == ""


# -- map ---------------------------------------------------------------------------------------


def test_map_info(hall: Hall) -> None:
    known, map_id = load_map(hall.map)
    facts = json.loads(amr_slam_process("map", "info", hall.map, "--json").out)
    assert facts == {
        "uuid": str(map_id),
        "name": "run",
        "format": 3,
        "bytes": hall.map.stat().st_size,
        "scans": len(known.path),
        "points": len(known),
        "area_m2": pytest.approx(known.area_m2(), abs=1e-3),
        "bounds_m": pytest.approx(known.bounds(), abs=1e-3),
    }
    said = amr_slam("map", "info", hall.map).out
    assert str(map_id) in said
    assert f"points    {len(known)}\n" in said


def test_map_render(hall: Hall, tmp_path: Path) -> None:
    for ending, beginning in ((".png", b"\x89PNG"), (".svg", b"<?xml")):
        out = tmp_path / f"hall{ending}"
        done = amr_slam("map", "render", hall.map, "--out", out)
        assert (done.status, done.err) == (0, "")
        assert out.read_bytes().startswith(beginning)


def test_map_export(hall: Hall, tmp_path: Path) -> None:
    known, _ = load_map(hall.map)
    target = known.target()
    for ending in ("pgm", "csv", "ply", "tum"):
        done = amr_slam("map", "export", hall.map, "--out", tmp_path / f"hall.{ending}")
        assert (done.status, done.err) == (0, "")
        assert f"hall.{ending}: " in done.out
    header, size, depth, pixels = (tmp_path / "hall.pgm").read_bytes().split(b"\n", 3)
    assert (header, depth) == (b"P5", b"255")
    columns, rows = map(int, size.split())
    image = np.frombuffer(pixels, np.uint8).reshape(rows, columns)
    settings = dict(
        line.split(": ", 1) for line in (tmp_path / "hall.yaml").read_text().splitlines()
    )
    assert settings["image"] == '"hall.pgm"'
    resolution = float(settings["resolution"])
    origin = np.array(json.loads(settings["origin"])[:2])
    column, row = np.floor((target.points_m - origin) / resolution).astype(int).T
    assert set(image[rows - 1 - row, column]) == {0}
    assert (image == 0).sum() == len(set(zip(column, row, strict=True)))
    # By the thresholds written, grey 254 is free, 205 neither free nor occupied.
    occupied, free = float(settings["occupied_thresh"]), float(settings["free_thresh"])
    assert (255 - 254) / 255 < free < (255 - 205) / 255 < occupied < 1.0
    assert (image == 254).sum() * resolution**2 == pytest.approx(known.area_m2(), rel=0.05)
    points = np.loadtxt(tmp_path / "hall.csv", delimiter=",", skiprows=1)
    assert points == pytest.approx(np.hstack([target.points_m, target.normals]), abs=1e-4)
    cloud = (tmp_path / "hall.ply").read_text().split("end_header\n")
    assert f"element vertex {len(target)}\n" in cloud[0]
    assert len(cloud[1].splitlines()) == len(target)
    assert len(read_tum(tmp_path / "hall.tum")) == len(known.path)


def test_an_empty_map_can_be_shown(tmp_path: Path) -> None:
    save_map(PointMap(SlamParams().map, "nothing"), tmp_path / "nothing.amrmap")
    for out in ("a.png", "a.pgm", "a.csv", "a.tum"):
        action = "render" if out == "a.png" else "export"
        done = amr_slam("map", action, tmp_path / "nothing.amrmap", "--out", tmp_path / out)
        assert done.status == 0


# -- daemon and fleet --------------------------------------------------------------------------


def test_check_validates_a_configuration(hall: Hall, tmp_path: Path) -> None:
    assert amr_slam("check", "--config", hall.config).status == 0
    bad = tmp_path / "bad.toml"
    bad.write_text(CONFIG.replace("track_m", "trakc_m"))
    for command in ("check", "run"):
        done = amr_slam(command, "--config", bad)
        assert done.status == 2
        assert error_line(done).startswith(f"{bad}: drive.trakc_m: unknown key; did you mean ")


def test_run_and_check_hand_over_to_the_service(
    hall: Hall, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[object] = []

    def run(config: Config, config_path: Path, record: Path | None, started: Started) -> int:
        assert config.robot.name
        assert started.slam is not None
        assert started.slam.process.is_alive()  # began its imports before us
        seen.extend((config_path, record))
        return 130

    def check(config: Config, config_path: Path, *, probe: bool) -> int:
        assert config.robot.name
        seen.extend((config_path, probe))
        return 1

    monkeypatch.setattr(daemon, "run", run)
    monkeypatch.setattr(probe, "check", check)
    assert amr_slam("run", "--config", hall.config).status == 130
    record = tmp_path / "all.mcap"
    assert amr_slam("run", "--config", hall.config, "--record", record).status == 130
    assert amr_slam("check", "--config", hall.config, "--probe").status == 1
    assert amr_slam("check", "--config", hall.config).status == 1
    runs = [hall.config, None, hall.config, record]
    assert seen == [*runs, hall.config, True, hall.config, False]
    for wrong in ("no/such/folder/a.mcap", "a.bag"):
        assert amr_slam("run", "--config", hall.config, "--record", wrong).status == 2


def test_watch_asks_whom_it_is_told_to(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[str, list[str], dict[str, Any]]] = []
    usual = {"prefix": "amr", "keys": None, "sort": "name", "form": "text", "once": False}

    def watch(endpoint: str, robots: list[str], **options: Any) -> None:
        seen.append((endpoint, robots, options))
        if robots:
            raise SessionError(f"nobody at {endpoint}")

    monkeypatch.setattr(fleet, "watch", watch)
    assert amr_slam("watch").status == 0
    to = ["--connect", "tcp/10.0.0.7:7447", "--keys", "k", "--prefix", "works"]
    done = amr_slam("watch", *to, "--sort", "state", "--json", "--once", "amr7", "amr8")
    assert done.status == 1
    assert error_line(done) == "nobody at tcp/10.0.0.7:7447"
    assert seen == [
        (DEFAULT_ENDPOINT, [], usual),
        (
            "tcp/10.0.0.7:7447",
            ["amr7", "amr8"],
            {"prefix": "works", "keys": Path("k"), "sort": "state", "form": "json", "once": True},
        ),
    ]


# -- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["fly"], "invalid choice: 'fly'"),
        (["replay"], "the following arguments are required: LOG"),
        (["replay", "a.log", "--bogus"], "unrecognized arguments: --bogus"),
        (["replay", "a.log", "--lidar", "1,2"], "argument --lidar: '1,2' is not X,Y,THETA_DEG"),
        (["replay", "a.log", "--lidar", "-1,2,inf"], "argument --lidar: 'inf' is not a number"),
        (["replay", "a.log", "--scan-period", "-1"], "'-1' is not a number of at least 0"),
        (["replay", "a.log", "--keep", "many"], "'many' is not a number from 0 to 999"),
        (["replay", "a.log", "--map-out", "a.map"], "'a.map' does not end in .amrmap"),
        (["replay", "a.log", "--config", "a", "--preset", "paper"], "not allowed with argument"),
        (["replay", "a.log", "--no-mapping"], "--no-mapping needs a --map"),
        (["replay", "a.log", "--map", "a.amrmap", "--map-out", "b.amrmap"], "needs --mapping"),
        (["replay", "a.log", "--out", "nowhere/a.tum"], "there is no folder nowhere"),
        (["replay", "a.log", "--out", "a.tum", "--out-final", "a.tum"], "named for two outputs"),
        (["replay", "a.log", "--out", "a.log"], "a.log: is what is read"),
        (["replay", "a.log", "--config", "nowhere.toml"], "nowhere.toml: No such file"),
        (["localize", "a.log"], "the following arguments are required: --map"),
        (["map", "render", "a.amrmap", "--out", "a.jpg"], "does not end in .png or .svg"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(arguments: list[str], reason: str) -> None:
    done = amr_slam(*arguments)
    assert done.status == 2
    assert reason in error_line(done)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["replay", "nowhere.log"], "nowhere.log: "),
        (["replay", __file__], "not a log"),
        (["map", "info", "nowhere.amrmap"], "nowhere.amrmap: cannot read the map"),
        (["map", "info", __file__], "not a map file"),
    ],
)
def test_what_fails_is_said_in_one_line(arguments: list[str], reason: str) -> None:
    done = amr_slam(*arguments)
    assert done.status == 1
    assert reason in error_line(done)


def test_a_damaged_log_line_is_named(hall: Hall, tmp_path: Path) -> None:
    lines = hall.carmen.read_text().splitlines()
    lines[4] = lines[4][: len(lines[4]) // 2]
    damaged = tmp_path / "damaged.log"
    damaged.write_text("\n".join(lines))
    done = amr_slam_process("replay", damaged, "--lidar", "0,0,0")
    assert done.status == 1
    assert error_line(done).startswith(f"{damaged}:5: FLASER has ")


def test_a_damaged_map_is_refused(hall: Hall, tmp_path: Path) -> None:
    content = bytearray(hall.map.read_bytes())
    content[len(content) // 2] ^= 1
    damaged = tmp_path / "damaged.amrmap"
    damaged.write_bytes(content)
    for command in (
        ["map", "info", damaged],
        ["localize", "--map", damaged, hall.log, "--config", hall.config],
        ["replay", "--map", damaged, hall.log, "--config", hall.config],
    ):
        done = amr_slam(*command)
        assert done.status == 1
        assert error_line(done).startswith(f"{damaged}: the file is damaged")


def test_a_log_and_a_configuration_that_do_not_fit(hall: Hall, tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text(CONFIG.replace('"rear"', '"left"'))
    for arguments, reason in (
        ([hall.log], f"{hall.log}: where do its scanners sit (front, rear)?"),
        ([hall.log, "--lidar", "0,0,0"], "holds wheel angles"),
        ([hall.log, "--config", other], f"{other}: scanners: rear"),
        ([hall.carmen, "--config", hall.config, "--lidar", "0,0,0"], "holds integrated poses"),
    ):
        done = amr_slam("replay", *arguments)
        assert done.status == 2
        assert reason in error_line(done)
    other.write_text(CONFIG + "\n[servise]\n")
    done = amr_slam("replay", hall.log, "--config", other)
    assert done.status == 2
    assert error_line(done).startswith(f"{other}: servise: unknown key; did you mean service?")


def test_a_full_disk_names_the_file(hall: Hall) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full on this system")
    done = amr_slam("replay", hall.carmen, "--lidar", "0,0,0", "--out", full)
    assert done.status == 1
    assert error_line(done) == "/dev/full: No space left on device"


def test_ctrl_c_ends_with_130(hall: Hall, tmp_path: Path) -> None:
    fifo = tmp_path / "endless.log"
    os.mkfifo(fifo)
    command: list[str | Path] = [sys.executable, "-m", "amr_slam", "replay", fifo]
    pipe = subprocess.PIPE
    # The second opening returns when the command has opened its end too, and waits for lines.
    with subprocess.Popen(command, stdout=pipe, stderr=pipe) as process, fifo.open("w"):
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, b"", b"")


def test_the_unexpected_crashes_loudly(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(arguments: object) -> int:
        raise RuntimeError("nobody thought of this")

    module = types.ModuleType("broken")
    module.__dict__.update(run=run, FAILURES={})
    monkeypatch.setitem(sys.modules, "broken", module)
    monkeypatch.setitem(MODULES, "watch", "broken")
    with pytest.raises(RuntimeError):
        main(["watch"])


def test_names_cannot_write_a_second_line(tmp_path: Path) -> None:
    done = amr_slam("map", "info", f"{tmp_path}/a\nb\x1b[31m.amrmap")
    assert done.status == 1
    assert "a b?[31m.amrmap" in error_line(done)


def test_without_its_library_foxglove_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    monkeypatch.delitem(sys.modules, "amr_slam.watching.foxglove_live", raising=False)
    assert main(["foxglove"]) == 2
    assert "pip install 'foxglove-sdk" in capsys.readouterr().err


def test_a_port_that_is_none_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["foxglove", "--port", "65536"])
    assert "is not a port" in capsys.readouterr().err
