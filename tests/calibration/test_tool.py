from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest
from paths import REPO

from amr_slam.config import load
from amr_slam.geometry import Pose2
from amr_slam.recording import RecordingWriter
from amr_slam.samples import OdometrySample, Scan
from amr_slam.studies.calibrating import BuiltRobot, drive

CONFIG = """
[robot]
name = "amr7"
[drive]
kind = "differential"
radius_left_m = 0.1
radius_right_m = 0.1
track_m = 0.5
[odometry]
driver = "mock"
[[scanners]]
name = "front"
driver = "mock"
mounting = { x_m = 0.24, y_m = 0.2, theta_deg = 45.0 }
[[scanners]]
name = "rear"
driver = "mock"
mounting = { x_m = -0.24, y_m = -0.2, theta_deg = -135.0 }
[map]
mode = "mapping"
"""


def calibrated(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(REPO / "tools/calibrate.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def built(folder: Path) -> BuiltRobot:
    built = drive(seed=4, duration_s=80.0, scan_period_s=1.0)
    (folder / "robot.toml").write_text(CONFIG)
    with RecordingWriter(folder / "drive.mcap") as writer:
        for sample in built.samples:
            writer.write(sample)
    return built


def test_a_drive_gives_the_lines_of_the_configuration(folder: Path, built: BuiltRobot) -> None:
    picture = folder / "drive.png"
    done = calibrated(
        folder / "drive.mcap", "--config", folder / "robot.toml", "--plot", picture,
        "--scan-period", 1.0,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    told, lines = done.stdout.split("\n\n")
    assert "left radius mm" in told
    # As a technician would: the printed lines in the place of the old ones.
    drive_lines, front, rear = lines.split("# scanner ")
    text = CONFIG.replace(
        "radius_left_m = 0.1\nradius_right_m = 0.1\ntrack_m = 0.5\n",
        drive_lines.removeprefix("[drive]\n"),
    )
    for name, part, old in (
        ("front", front, "mounting = { x_m = 0.24, y_m = 0.2, theta_deg = 45.0 }\n"),
        ("rear", rear, "mounting = { x_m = -0.24, y_m = -0.2, theta_deg = -135.0 }\n"),
    ):
        text = text.replace(old, part.removeprefix(name))
    (folder / "better.toml").write_text(text)
    config, truth = load(folder / "better.toml"), built.truth
    found = config.drive
    assert getattr(found, "radius_left_m", 0.0) == pytest.approx(truth.radius_left_m, rel=1e-3)
    assert getattr(found, "track_m", 0.0) == pytest.approx(truth.track_m, rel=3e-3)
    for scanner, true in zip(config.scanners, truth.scanners, strict=True):
        mounting = scanner.mounting.mounting.base_from_lidar
        assert mounting.distance_to(true.base_from_lidar) < 0.005
        assert abs(mounting.theta_rad - true.base_from_lidar.theta_rad) < math.radians(0.1)
        assert scanner.mounting.lag_s == pytest.approx(true.lag_s, abs=0.005)
    checked = calibrated(
        folder / "drive.mcap", "--config", folder / "better.toml", "--check", "--scan-period", 1.0
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert "agrees with this drive" in checked.stdout


def test_a_robot_that_is_no_longer_as_configured_is_told(folder: Path, built: BuiltRobot) -> None:
    done = calibrated(
        folder / "drive.mcap", "--config", folder / "robot.toml", "--check", "--scan-period", 2.0
    )
    assert done.returncode == 1
    assert "left radius: configured 100 mm, the drive says" in done.stdout


def test_recordings_that_cannot_tell_are_refused_in_one_line(
    folder: Path, built: BuiltRobot
) -> None:
    wheels_only, poses_only = folder / "wheels.mcap", folder / "poses.mcap"
    with RecordingWriter(wheels_only) as writer:
        for sample in built.samples:
            if not isinstance(sample, Scan):
                writer.write(sample)
    with RecordingWriter(poses_only) as writer:
        writer.write(OdometrySample(stamp_ns=1, odom_from_base=Pose2.identity()))
    config = folder / "robot.toml"
    for log, said in ((wheels_only, "no scan of a scanner"), (poses_only, "no wheel angles")):
        done = calibrated(log, "--config", config)
        assert done.returncode == 1
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
    done = calibrated(wheels_only, "--config", folder / "absent.toml")
    assert done.returncode == 2
