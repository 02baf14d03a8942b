"""The paper's figure 4 from a small recording."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from amr_slam.geometry import Pose2
from amr_slam.recording import RecordingError
from amr_slam.simulation import ScannerModel, laboratory, plan_tour, take_scan
from amr_slam.studies.paper_figures import midway, real
from amr_slam.studies.report import Effort


def carmen(path: Path, seconds: range) -> Path:
    """A robot that drives ahead at 0.1 m/s, a scan of 180 degrees each second."""
    world = laboratory(3)
    start = plan_tour(world).world_from_map
    model = ScannerModel(
        beams=181, angle_min_rad=-math.pi / 2, angle_step_rad=math.pi / 180, sigma_range_m=0.01
    )
    rng = np.random.default_rng(0)
    lines = []
    for second in seconds:
        here = Pose2(0.1 * second, 0.0, 0.0)
        ranges = take_scan(model, world, start @ here, rng).ranges_m
        values = " ".join(f"{value:.3f}" for value in np.nan_to_num(ranges, posinf=81.83))
        pose = f"{here.x_m:.3f} 0 0"
        lines += [
            f"ODOM {pose} 0.1 0 0 {second}.0 host {second}.0",
            f"FLASER 181 {values} {pose} {pose} {second}.01 host {second}.01",
            f"ODOM {pose} 0.1 0 0 {second}.02 host {second}.02",
        ]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_map_stops_midway_with_the_scan_on_its_walls(tmp_path: Path) -> None:
    log = carmen(tmp_path / "hall.log", range(1, 30))
    shown = midway(log, 6)
    # The first begins the map, six are registered in it: one in two seconds at 0.1 m/s.
    assert len(shown.known.path) == 7
    assert shown.path_m == pytest.approx(np.outer(np.arange(7), [0.2, 0.0]), abs=0.02)
    walls = shown.known.target().points_m
    off = np.linalg.norm(shown.scan_m[:, None] - walls[None], axis=2).min(axis=1)
    assert np.median(off) < 0.05
    section = real(Effort(scale=0.01, progress=lambda _: None), log)
    assert [picture.name for picture in section.pictures] == ["figure4"]
    assert "hall" in section.text


def test_a_log_without_scans_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.log"
    path.write_text("ODOM 0 0 0 0 0 0 1.0 host 1.0\n")
    with pytest.raises(RecordingError):
        midway(path, 3)
