"""What ``map.extend`` and ``map.hold`` say of a start."""

from __future__ import annotations

from pathlib import Path

import pytest
from robot_file import edited

from amr_slam import config
from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.service.daemon import first_jobs
from amr_slam.slam_messages import SlamJob


def begun(folder: Path, told: str, cut_off: str | None = None) -> tuple[SlamJob, SlamJob | None]:
    text = edited('mode = "mapping"', f'mode = "mapping"\ndirectory = "{folder}"\n{told}')
    (folder / "robot.toml").write_text(text)
    return first_jobs(config.load(folder / "robot.toml"), cut_off)


def test_a_map_that_is_there_is_extended_where_the_configuration_says_so(tmp_path: Path) -> None:
    job, wanted = begun(tmp_path, "extend = true")
    # There is none: a new one begins.
    assert (job.mode, job.source, wanted) == ("mapping", None, None)
    path = tmp_path / "map.amrmap"
    save_map(PointMap(MapParams()), path)
    job, wanted = begun(tmp_path, "extend = false")
    assert (job.mode, job.source, wanted) == ("mapping", None, None)
    job, wanted = begun(tmp_path, "extend = true")
    # The robot is found in it first; then it grows on, the old part held.
    assert (job.mode, job.source, job.target) == ("localization", path, None)
    assert wanted is not None
    assert (wanted.mode, wanted.source, wanted.target) == ("mapping", path, path)
    assert wanted.hold
    assert not wanted.saved_before  # the map of before is worth keeping


@pytest.mark.parametrize(
    ("told", "held"), [("extend = true", True), ("extend = true\nhold = false", False), ("", False)]
)
def test_old_parts_are_held_where_they_are_extended(tmp_path: Path, told: str, held: bool) -> None:
    save_map(PointMap(MapParams()), tmp_path / "map.amrmap")
    job, wanted = begun(tmp_path, told, cut_off="map")
    assert job.mode == "localization"
    assert wanted is not None
    assert wanted.hold is held
    assert wanted.saved_before
    # What was cut off is another map's: none of this one's business.
    assert (begun(tmp_path, told, cut_off="other")[1] is not None) is ("extend" in told)
