"""amr-slam map align, as people call it."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import matplotlib.image as mpl_image
import numpy as np
import pytest
from camera_drives import MARKER, SITE_FROM_MAP, draw_plan, drive, seen_by_cameras
from labs import cloud_at, covered_poses, heading_error_rad, lab, mapped_lab
from test_cli import amr_slam, error_line

from amr_slam.engine import SlamEngine
from amr_slam.map import load_map, save_map
from amr_slam.params import preset
from amr_slam.recording import write_tum
from amr_slam.slam_request import SlamRequest


@pytest.fixture
def hall(tmp_path: Path) -> Path:
    """The map of laboratory 3. Its frame is the world's; the drive's begins at the tour's start."""
    save_map(mapped_lab(3), tmp_path / "hall.amrmap")
    return tmp_path / "hall.amrmap"


def landmarks(folder: Path, wrong_m: float = 0.0) -> Path:
    path = folder / "landmarks.csv"
    points = np.array([[1.0, 1.0], [9.0, 1.5], [8.5, 10.0], [0.5, 9.0], [4.0, 6.0]])
    site = SITE_FROM_MAP @ points
    site[4, 0] += wrong_m
    rows = [
        f"corner {i},{p[0]:.4f},{p[1]:.4f},{s[0]:.4f},{s[1]:.4f}"
        for i, (p, s) in enumerate(zip(points, site, strict=True))
    ]
    path.write_text("name,x_map,y_map,x_site,y_site\n" + "\n".join(rows) + "\n")
    return path


def test_landmarks_make_a_new_map_in_which_poses_are_the_old_ones_moved(hall: Path) -> None:
    out, picture = hall.with_name("site.amrmap"), hall.with_name("site.png")
    before = hall.read_bytes()
    done = amr_slam(
        "map", "align", hall, "--landmarks", landmarks(hall.parent), "--out", out,
        "--picture", picture, "--residuals", hall.with_name("left.csv"),
    )  # fmt: skip
    assert (done.status, done.err) == (0, "")
    assert "corner 3" in done.out
    assert "x +12.300 m, y -4.500 m, theta +40.000 deg" in done.out
    assert hall.read_bytes() == before
    assert mpl_image.imread(picture).shape[0] > 600
    assert len(hall.with_name("left.csv").read_text().splitlines()) == 6
    old, old_id = load_map(hall)
    new, new_id = load_map(out)
    assert new_id != old_id
    assert new.name == "site"
    (told,) = new.reframings
    assert (told.map_id, told.by, told.used) == (str(old_id), "landmarks.csv", 5)
    for pose in covered_poses(3, 2):
        cloud = cloud_at(lab(3), pose, np.random.default_rng(5), sigma_m=0.01)
        fixes = []
        for known in (old, new):
            engine = SlamEngine(preset("default"), known, "localization")
            found = engine.update(SlamRequest(cloud=cloud, map_from_base=None, covariance=None))
            assert found.fix is not None
            fixes.append(found.fix.map_from_base)
        expected = SITE_FROM_MAP @ fixes[0]
        assert fixes[1].distance_to(expected) < 0.01
        assert heading_error_rad(fixes[1], expected) < math.radians(0.15)

    info = amr_slam("map", "info", out)
    assert f"aligned   from {old_id} by landmarks.csv: x +12.300 m" in info.out
    as_json = json.loads(amr_slam("map", "info", out, "--json").out)
    assert as_json["reframings"][0]["theta_rad"] == pytest.approx(math.radians(40.0), abs=1e-4)


def test_a_landmark_that_contradicts_is_named(hall: Path) -> None:
    table, out = landmarks(hall.parent, wrong_m=1.0), hall.with_name("site.amrmap")
    done = amr_slam("map", "align", hall, "--landmarks", table, "--out", out)
    assert done.status == 0
    assert "5: 4 agree, 1 left out" in done.out
    assert "left out: corner 4: 1.00 m off" in done.out


def test_cameras_and_drive_by_time(hall: Path) -> None:
    folder = hall.parent
    camera, _ = seen_by_cameras(drive(), np.random.default_rng(0))
    rows = [
        f"{1e-9 * stamp:.4f},{x:.4f},{y:.4f},{math.degrees(theta):.3f}"
        for stamp, (x, y, theta) in zip(camera.stamps_ns, camera.poses.tolist(), strict=True)
    ]
    (folder / "cameras.csv").write_text("stamp,x,y,theta_deg\n" + "\n".join(rows) + "\n")
    write_tum(folder / "drive.tum", drive())
    out = folder / "site.amrmap"
    command = ("map", "align", hall, "--camera", folder / "cameras.csv", "--slam",
               folder / "drive.tum", "--out", out)  # fmt: skip
    done = amr_slam(*command)
    assert done.status == 0, done.err
    assert "x +12.300 m, y -4.500 m" in done.out or "x +12.300 m, y -4.501 m" in done.out
    assert "marker      x +0.1" in done.out
    clock = re.search(r"camera's stamp (\S+) s is the map's", done.out)
    assert clock is not None
    assert float(clock[1]) == pytest.approx(-0.08, abs=0.006)
    # Known beforehand: neither is estimated.
    mounted = f"{MARKER.x_m},{MARKER.y_m},{math.degrees(MARKER.theta_rad)}"
    told = amr_slam(*command, "--marker", mounted, "--clock", -0.08)
    assert told.status == 0, told.err
    assert "(as given)" in told.out
    assert "marker  " not in told.out
    # A marker that is said to sit elsewhere does not fit.
    wrong = amr_slam(*command, "--marker", "-0.4,0.3,0")
    assert wrong.status == 1
    assert "rms are left between both" in wrong.err or "agree" in wrong.err


def test_a_floor_plan(hall: Path) -> None:
    corner = draw_plan(lab(3), SITE_FROM_MAP, hall.with_name("plan.png"))
    out = hall.with_name("site.amrmap")
    plan = ("map", "align", hall, "--floor-plan", hall.with_name("plan.png"), "--resolution", 0.05,
            "--out", out, "--picture", hall.with_name("fit.svg"))  # fmt: skip
    done = amr_slam(*plan, "--origin", f"{corner.x_m},{corner.y_m}")
    assert done.status == 0, done.err
    found = load_map(out)[0].reframings[0].site_from_map
    assert found.distance_to(SITE_FROM_MAP) < 0.03
    assert "are in the plan" in done.out
    # Searched only about where it is not.
    elsewhere = amr_slam(*plan, "--origin", f"{corner.x_m},{corner.y_m}", "--near", "-3,-9,200")
    assert elsewhere.status == 1
    assert "not aligned" in elsewhere.err or "fits nowhere" in elsewhere.err


def test_what_does_not_fit_is_refused_and_leaves_no_map(hall: Path) -> None:
    folder, out = hall.parent, hall.with_name("site.amrmap")
    rng = np.random.default_rng(0)
    rows = [",".join(f"{number:.3f}" for number in rng.uniform(0, 9, 4)) for _ in range(30)]
    (folder / "pairs.csv").write_text("camera_x,camera_y,slam_x,slam_y\n" + "\n".join(rows) + "\n")
    align = ("map", "align", hall, "--pairs", folder / "pairs.csv", "--out", out)
    done = amr_slam(*align, "--picture", folder / "why.png")
    assert done.status == 1
    assert done.err.startswith(f"amr-slam: error: {hall}: not aligned: only ")
    assert "of the pairs agree" in done.err
    assert (folder / "why.png").exists()
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--camera", "a.csv"], "--camera and --slam belong together"),
        (["--pairs", "a.csv", "--clock", "1"], "--clock belongs to --camera"),
        (["--landmarks", "a.csv", "--marker", "0,0,0"], "--marker belongs to"),
        (["--pairs", "a.csv", "--near", "-1,0,0"], "--near belongs to --floor-plan"),
        (["--pairs", "a.csv", "--landmarks", "b.csv"], "not allowed with"),
        ([], "one of the arguments"),
    ],
)
def test_arguments_that_do_not_go_together(
    hall: Path, arguments: list[str], complaint: str
) -> None:
    done = amr_slam("map", "align", hall, *arguments, "--out", hall.with_name("site.amrmap"))
    assert done.status == 2
    assert complaint in error_line(done)


def test_files_that_are_missing_or_would_be_overwritten(hall: Path) -> None:
    out = hall.with_name("site.amrmap")
    done = amr_slam("map", "align", hall, "--pairs", hall.with_name("no.csv"), "--out", out)
    assert done.status == 1
    assert "no.csv: No such file" in error_line(done)
    table = landmarks(hall.parent)
    done = amr_slam("map", "align", hall, "--landmarks", table, "--out", hall)
    assert done.status == 2
    assert "is what is read" in error_line(done)
    done = amr_slam("map", "align", hall, "--landmarks", table, "--out", out, "--residuals", table)
    assert done.status == 2
