"""The map of a furnished laboratory, laid on the plan of its bare building."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from camera_drives import draw_plan
from labs import cloud_at, lab, mapped_lab, room
from PIL import Image

from amr_slam.aligning import AlignError, FloorPlan, PlanParams, fit_plan, read_plan
from amr_slam.geometry import Pose2, wrap_angle
from amr_slam.map import MapParams, PointMap

SITE = Pose2(30.0, -12.0, math.radians(75.0))


@pytest.mark.parametrize("seed", [3, 8])
def test_walls_without_furniture_and_with_doors_are_found(tmp_path: Path, seed: int) -> None:
    corner = draw_plan(lab(seed), SITE, tmp_path / "plan.png")
    plan = read_plan(tmp_path / "plan.png", 0.05, corner)
    fit = fit_plan(mapped_lab(seed), plan, PlanParams())
    error = SITE.inverse() @ fit.exact.site_from_map
    assert fit.problems == fit.findings == ()
    assert error.distance_to(Pose2.identity()) < 0.03
    assert abs(math.degrees(error.theta_rad)) < 0.2
    assert fit.exact.rms_m < 0.05
    assert fit.shared < 0.8  # the rest is furniture
    assert fit.rival is not None
    assert fit.rival[1] < 0.7


def test_a_plan_with_a_wrong_resolution_is_a_finding(tmp_path: Path) -> None:
    corner = draw_plan(lab(3), SITE, tmp_path / "plan.png")
    plan = read_plan(tmp_path / "plan.png", 0.0505, corner)
    fit = fit_plan(mapped_lab(3), plan, PlanParams())
    assert fit.exact.scale == pytest.approx(1.01, abs=0.005)
    assert any("larger than the map by 1." in finding for finding in fit.findings)
    assert fit.exact.rms_m > 0.05


def test_the_plan_of_another_building_is_refused(tmp_path: Path) -> None:
    corner = draw_plan(lab(5), SITE, tmp_path / "plan.png")
    plan = read_plan(tmp_path / "plan.png", 0.05, corner)
    fit = fit_plan(mapped_lab(3), plan, PlanParams())
    assert fit.problems


def test_a_hall_that_looks_alike_the_other_way_round_is_ambiguous() -> None:
    grown, rng = PointMap(MapParams(), "room"), np.random.default_rng(0)
    for x_m in (1.5, 4.0, 6.5):
        grown.insert(
            cloud_at(room(), Pose2(x_m, 3.0, 0.3), rng, sigma_m=0.01), Pose2(x_m, 3.0, 0.3)
        )
    points, normals = [], []
    for start, end, normal in (
        ((0.0, 0.0), (8.0, 0.0), (0.0, 1.0)),
        ((8.0, 0.0), (8.0, 6.0), (-1.0, 0.0)),
        ((8.0, 6.0), (0.0, 6.0), (0.0, -1.0)),
        ((0.0, 6.0), (0.0, 0.0), (1.0, 0.0)),
    ):
        points.append(np.linspace(start, end, 120))
        normals.append(np.tile(normal, (120, 1)))
    plan = FloorPlan(
        points_m=np.concatenate(points), normals=np.concatenate(normals), resolution_m=0.05
    )
    refused = fit_plan(grown, plan, PlanParams())
    assert any("ambiguous" in problem and "--near" in problem for problem in refused.problems)
    half_turn = Pose2(8.0, 6.0, math.pi)
    for truth in (Pose2.identity(), half_turn):
        hint = Pose2(truth.x_m + 0.8, truth.y_m - 0.6, truth.theta_rad + 0.2)
        fit = fit_plan(grown, plan, PlanParams(), hint)
        assert fit.problems == ()
        assert fit.exact.site_from_map.distance_to(truth) < 0.02
        assert abs(wrap_angle(fit.exact.site_from_map.theta_rad - truth.theta_rad)) < 0.005


def test_a_map_server_s_files_are_read(tmp_path: Path) -> None:
    corner = draw_plan(lab(3), SITE, tmp_path / "plan.pgm")
    (tmp_path / "plan.yaml").write_text(
        f"image: plan.pgm\nmode: trinary\nresolution: 0.05  # m\n"
        f"origin: [{corner.x_m}, {corner.y_m}, 0.0]\nnegate: 0\noccupied_thresh: 0.5\n"
    )
    described = read_plan(tmp_path / "plan.yaml", None, None)
    plain = read_plan(tmp_path / "plan.pgm", 0.05, corner)
    np.testing.assert_allclose(described.points_m, plain.points_m)


def test_faces_lie_at_the_edge_of_what_is_dark(tmp_path: Path) -> None:
    dark = np.full((100, 200), 255, dtype=np.uint8)
    dark[40:50, 50:150] = 0  # 0.5 m thick, 5 m long, lower edge 2.5 m above the picture's
    Image.fromarray(dark).save(tmp_path / "wall.png")
    plan = read_plan(tmp_path / "wall.png", 0.05, Pose2(10.0, 20.0, 0.0))
    upper = plan.points_m[plan.normals[:, 1] > 0.99]
    lower = plan.points_m[plan.normals[:, 1] < -0.99]
    np.testing.assert_allclose(upper[:, 1], 23.0, atol=1e-9)
    np.testing.assert_allclose(lower[:, 1], 22.5, atol=1e-9)
    assert upper[:, 0].min() == pytest.approx(12.5, abs=0.2)
    assert upper[:, 0].max() == pytest.approx(17.5, abs=0.2)


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("plan.png", b"no picture", "not a picture"),
        ("plan.yaml", b"image: x.png\n", "must stand in it|could not convert"),
        ("plan.yaml", b"image: x.png\nresolution: 0.05\norigin: [0, 0]\n", "must stand in it"),
        ("plan.yaml", b"\xff\xfe", "cannot be read"),
    ],
)
def test_what_is_no_plan_is_refused(
    tmp_path: Path, name: str, content: bytes, complaint: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(AlignError, match=complaint):
        read_plan(tmp_path / name, None if name.endswith("yaml") else 0.05, None)


def test_white_and_huge_pictures_are_refused(tmp_path: Path) -> None:
    Image.new("L", (50, 50), 255).save(tmp_path / "white.png")
    with pytest.raises(AlignError, match="nothing dark"):
        read_plan(tmp_path / "white.png", 0.05, None)
    Image.new("1", (20_000, 10_000), 1).save(tmp_path / "huge.png")
    with pytest.raises(AlignError, match=r"shrink it|too many pixels|exceeds limit"):
        read_plan(tmp_path / "huge.png", 0.05, None)
    with pytest.raises(AlignError, match="--resolution"):
        read_plan(tmp_path / "white.png", None, None)
