"""The Cramér-Rao bound: reached by least squares on known walls, and by nothing below it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from labs import EXACT, corridor, room

from amr_slam.geometry import Array, Pose2
from amr_slam.simulation import ScannerModel, World, take_scan
from amr_slam.studies import bound
from amr_slam.studies.report import Effort, Section

POSE = Pose2(3.1, 2.3, 0.4)
SIGMA_M = 0.03
# Of a room of 8 x 6 m: each wall's outward normal and its distance from the origin.
NORMALS = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
DISTANCES_M = np.array([0.0, 8.0, 6.0, 0.0])


def least_squares(points_m: Array, start: Pose2) -> Array:
    """(3,) the pose at which points (n, 2) in the base frame lie on the room's walls best: each on
    its nearest, which at 3 cm of noise is the right one but for some points in the corners."""
    pose = start.as_array()
    for _ in range(4):
        moved = Pose2.from_array(pose) @ points_m
        to_walls = moved @ NORMALS.T - DISTANCES_M
        wall = np.argmin(np.abs(to_walls), axis=1)
        residual = to_walls[np.arange(len(moved)), wall]
        n, arm = NORMALS[wall], moved - pose[:2]
        lever = arm[:, 0] * n[:, 1] - arm[:, 1] * n[:, 0]
        pose = pose - np.linalg.lstsq(np.column_stack([n, lever]), residual, rcond=None)[0]
    return np.asarray(pose)


def errors_of(model: ScannerModel, world: World, trials: int) -> Array:
    """(trials, 3) least squares less truth."""
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(trials):
        ranges = take_scan(model, world, POSE, rng).ranges_m
        points = ranges[:, None] * np.column_stack(
            [np.cos(model.angles_rad), np.sin(model.angles_rad)]
        )
        found = least_squares(model.base_from_lidar @ points, POSE)
        errors.append(found - POSE.as_array())
    return np.array(errors)


@pytest.mark.parametrize("mounting", [Pose2.identity(), Pose2(0.5, -0.2, 1.1)])
def test_least_squares_on_known_walls_reaches_the_bound(mounting: Pose2) -> None:
    model = replace(EXACT, sigma_xy_m=SIGMA_M, base_from_lidar=mounting)
    errors = errors_of(model, room(), 1200)
    expected = bound.cramer_rao(room(), POSE, model, SIGMA_M)
    np.testing.assert_allclose(errors.std(axis=0), np.sqrt(np.diag(expected)), rtol=0.1)
    measured = np.corrcoef(errors.T)
    spread = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(measured, expected / np.outer(spread, spread), atol=0.1)


def test_each_beam_tells_of_the_wall_that_it_meets() -> None:
    """A wall across with a gap in it; behind the gap one along y = 0.4, and behind the wall one
    along y = 0, whose extension the middle beam's end lies on."""
    walls = np.array([[5, 0, 6, 0], [2, -5, 2, 0.1], [2, 0.5, 2, 5], [2.2, 0.4, 5, 0.4]])
    world = replace(room(), segments_m=walls, outline_m=walls[:, :2])
    model = replace(EXACT, angle_min_rad=-0.6, angle_step_rad=0.15, beams=9)
    covariance = bound.cramer_rao(world, Pose2.identity(), model, 1.0)
    # The beam at 0.15 rad goes through the gap.
    tangents = 2.0 * np.tan([-0.6, -0.45, -0.3, -0.15, 0.0, 0.3, 0.45, 0.6])
    jacobian = [[1.0, 0.0, -t] for t in tangents] + [[0.0, 1.0, 0.4 / np.tan(0.15)]]
    expected = np.linalg.inv(np.transpose(jacobian) @ jacobian)
    np.testing.assert_allclose(covariance, expected, rtol=1e-9, atol=1e-12)


def test_an_endless_corridor_has_no_bound() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        bound.cramer_rao(corridor(), Pose2.identity(), EXACT, 0.1)


@pytest.fixture(scope="module")
def section() -> Section:
    """A quick look: two worlds, few poses."""
    patch = pytest.MonkeyPatch()
    patch.setattr(bound, "POSES", 6)
    patch.setattr(bound, "SIGMAS_M", (0.1,))
    try:
        return bound.run(Effort(scale=0.0, progress=lambda _: None))
    finally:
        patch.undo()


def test_the_study_reports_ratios_and_consistency(section: Section) -> None:
    accuracy, consistency = section.tables
    (row,) = accuracy.rows
    assert row[0] == "0.1"
    assert row[1].endswith("of 12")
    rmse_mm, bound_mm = float(row[3]), float(row[4])
    # 541 beams in 200 m2 at 0.1 m: about a centimetre.
    assert 5.0 < bound_mm < 20.0
    assert float(row[5].split()[0]) == pytest.approx(rmse_mm / bound_mm, abs=0.02)
    assert 0.5 < rmse_mm / bound_mm < 3.0
    assert float(consistency.rows[0][1].split()[0]) > 0.0
    assert [picture.name for picture in section.pictures] == ["bound"]
