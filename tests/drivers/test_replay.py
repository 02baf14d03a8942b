from __future__ import annotations

import time
from pathlib import Path

import pytest

from amr_drivers.errors import LinkLost
from amr_drivers.replay import odometry, scanner
from amr_drivers.replay.player import PLAYERS
from amr_slam.recording import read_log
from amr_slam.samples import OdometrySample, Scan

DEADLINE_S = 20.0


@pytest.fixture
def log(tmp_path: Path) -> Path:
    ranges = " ".join(["1.5"] * 180)
    lines = []
    for n in range(3):
        stamp = 1000.0 + 0.05 * n
        lines += [
            f"ODOM {0.1 * n} 0.0 0.0 0.3 0.0 0.0 {stamp} robot {stamp}",
            f"FLASER 180 {ranges} {0.1 * n} 0.0 0.0 {0.1 * n} 0.0 0.0 {stamp} robot {stamp}",
        ]
    path = tmp_path / "short.log"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_recording_is_played_in_real_time(log: Path) -> None:
    recorded = read_log(log).samples
    name = next(sample.scanner for sample in recorded if isinstance(sample, Scan))
    wheels = odometry.open_odometry(odometry.Settings(log=str(log)))
    front = scanner.open_scanner("front", scanner.Settings(log=str(log), source=name))
    assert PLAYERS._held[str(log)][1] == 2
    stamps_ns = []
    for n in range(3):
        sample, scan = wheels.read(DEADLINE_S), front.read(DEADLINE_S)
        assert isinstance(sample, OdometrySample)
        assert isinstance(scan, Scan)
        assert sample.odom_from_base.x_m == pytest.approx(0.1 * n)
        assert scan.scanner == "front"
        assert scan.stamp_ns <= time.monotonic_ns()
        assert abs(scan.stamp_ns - sample.stamp_ns) < 20_000_000
        stamps_ns.append(sample.stamp_ns)
    assert stamps_ns[2] - stamps_ns[0] == 100_000_000
    assert wheels.read(0.01) is None
    assert wheels.status() == (0, "the recording has ended")
    front.close()
    wheels.close()
    assert not PLAYERS._held
    with pytest.raises(LinkLost):
        front.read(0.0)


def test_a_name_that_is_not_in_the_recording_is_answered_with_those_that_are(log: Path) -> None:
    with pytest.raises(ValueError, match=r"no scanner 'rear'; scanners in it: \w+"):
        scanner.open_scanner("rear", scanner.Settings(log=str(log)))
    with pytest.raises(ValueError, match="absent"):
        odometry.open_odometry(odometry.Settings(log=str(log.with_name("absent.log"))))
    assert not PLAYERS._held
