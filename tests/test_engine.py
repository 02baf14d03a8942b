from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from labs import (
    cloud_at,
    corridor,
    exact_target,
    heading_error_rad,
    lab,
    mapped_lab,
    plain_cloud,
    room,
    tour_poses,
)

from amr_slam.clouds import Cloud
from amr_slam.engine import SlamEngine
from amr_slam.evidence import Rung, Verdict
from amr_slam.geometry import Array, Pose2, inverse_matrix
from amr_slam.map import MapParams, PointMap
from amr_slam.params import SlamParams
from amr_slam.registration.error import e_psr
from amr_slam.slam_request import SlamRequest, SlamResult

PARAMS = SlamParams()
SURE = np.diag([0.02**2, 0.02**2, math.radians(0.5) ** 2])
START = np.diag([1e-4, 1e-4, 1e-6])
# What wheels add to the uncertainty over 0.6 m.
STEP = np.diag([0.03**2, 0.02**2, math.radians(1.5) ** 2])


def request(cloud: Cloud, pose: Pose2 | None, covariance: Array | None = SURE) -> SlamRequest:
    return SlamRequest(
        cloud=cloud,
        map_from_base=pose,
        covariance=None if pose is None else covariance,
    )


def mapping_engine() -> SlamEngine:
    return SlamEngine(PARAMS, PointMap(MapParams()), "mapping")


def turned(covariance: Array, delta: Pose2) -> Array:
    """Carried over a step, roughly: the heading's part of the position grows with the way."""
    lever = np.eye(3)
    lever[1, 2] = delta.x_m
    return np.asarray(lever @ covariance @ lever.T + STEP)


def test_slam_from_nothing_but_scans_and_noisy_wheels() -> None:
    """A round through a laboratory: the map and the way end where they are in truth."""
    engine, rng = mapping_engine(), np.random.default_rng(0)
    truth = tour_poses(0)
    believed, covariance = Pose2.identity(), START
    off_m, off_rad = [], []
    for i, pose in enumerate(truth):
        if i:
            delta = truth[i - 1].inverse() @ pose
            slip = rng.multivariate_normal(np.zeros(3), STEP)
            believed = believed @ delta @ Pose2.exp(slip)
            covariance = turned(covariance, delta)
        cloud = cloud_at(lab(0), pose, rng, sigma_m=0.01, stamp_ns=i)
        result = engine.update(request(cloud, believed, covariance))
        assert result.stamp_ns == i
        if result.fix is not None:
            gain = covariance @ inverse_matrix(covariance + result.fix.covariance)
            believed = Pose2.from_array(
                believed.as_array()
                + gain
                @ [
                    result.fix.map_from_base.x_m - believed.x_m,
                    result.fix.map_from_base.y_m - believed.y_m,
                    math.remainder(
                        result.fix.map_from_base.theta_rad - believed.theta_rad, math.tau
                    ),
                ]
            )
            covariance = (np.eye(3) - gain) @ covariance
        expected = truth[0].inverse() @ pose
        off_m.append(believed.distance_to(expected))
        off_rad.append(heading_error_rad(believed, expected))
    assert math.sqrt(float(np.mean(np.square(off_m)))) < 0.03
    assert max(off_m) < 0.08
    assert math.degrees(max(off_rad)) < 1.0
    walls = truth[0] @ np.array(engine.map.target().points_m)
    true_walls = exact_target(lab(0), 0.01)
    assert e_psr(walls, true_walls.tree) < 0.03
    assert engine.map.area_m2() > 120.0
    assert result.map_scans == len(engine.map.path) > 0.9 * len(truth)


def test_the_first_scan_founds_the_map_where_the_robot_stands() -> None:
    engine = mapping_engine()
    pose = Pose2(1.0, 2.0, 0.5)
    empty = engine.update(request(plain_cloud(np.empty((0, 2))), pose))
    assert (empty.inserted, empty.map_scans, len(engine.map)) == (False, 0, 0)
    cloud = cloud_at(lab(0), tour_poses(0)[0], np.random.default_rng(0), stamp_ns=4)
    first = engine.update(request(cloud, pose))
    assert (first.inserted, first.fix, first.map_scans) == (True, None, 1)
    assert engine.map.path == [(4, pose)]


def test_a_standing_robot_does_not_grow_the_map() -> None:
    engine, rng = mapping_engine(), np.random.default_rng(0)
    world_from_map = tour_poses(0)[0]
    here = Pose2.identity()
    for i in range(12):
        cloud = cloud_at(lab(0), world_from_map, rng, sigma_m=0.01, stamp_ns=i)
        result = engine.update(request(cloud, here))
        assert result.inserted is (i == 0)
    assert result.map_scans == 1
    moved = Pose2(0.3, 0.0, 0.0)
    cloud = cloud_at(lab(0), world_from_map @ moved, rng, sigma_m=0.01)
    assert engine.update(request(cloud, moved)).inserted


def test_a_scan_that_contradicts_the_wheels_is_not_inserted() -> None:
    """The wheels are sure to stand here, the scan was taken a metre and a half away."""
    engine, rng = mapping_engine(), np.random.default_rng(0)
    poses = tour_poses(0)
    for pose in poses[:20]:
        engine.update(request(cloud_at(lab(0), pose, rng, sigma_m=0.01), pose))
    before = (len(engine.map), len(engine.map.path))
    cloud = cloud_at(lab(0), poses[10], rng, sigma_m=0.01)
    sure = np.diag([0.01**2, 0.01**2, math.radians(0.3) ** 2])
    believed = min(poses[:20], key=lambda pose: abs(pose.distance_to(poses[10]) - 1.5))
    result = engine.update(request(cloud, believed, sure))
    assert not result.inserted
    assert (len(engine.map), len(engine.map.path)) == before


def test_new_territory_joins_the_map_where_the_wheels_say() -> None:
    """Round a corner the map knows nothing: that is no failure, nor a reason to search."""
    engine = SlamEngine(PARAMS, PointMap(MapParams()), "mapping")
    rng = np.random.default_rng(0)
    first = tour_poses(0)[0]
    engine.update(request(cloud_at(lab(0), first, rng, sigma_m=0.01), first))
    elsewhere = Pose2(first.x_m + 20.0, first.y_m + 15.0, 0.0)
    cloud = cloud_at(corridor(), Pose2(0.0, 0.2, 0.0), rng, sigma_m=0.01)
    result = engine.update(request(cloud, elsewhere))
    assert (result.inserted, result.fix) == (True, None)
    assert result.answer.verdict is Verdict.UNKNOWN
    assert engine.map.path[-1][1] == elsewhere


def test_a_place_that_a_search_found_along_a_corridor_joins_the_map_where_the_wheels_say() -> None:
    """To a search, which knows nothing of the wheels, any place along the walls is as good: what
    joins the map there, metres away, is where later scans will be found."""
    engine, rng = mapping_engine(), np.random.default_rng(0)
    for x in np.arange(-6.0, 0.1, 0.6):
        pose = Pose2(float(x), 0.1, 0.0)
        engine.update(request(cloud_at(corridor(), pose, rng, sigma_m=0.01), pose, START))
    # Nothing is good enough near the expected pose, so that the search has the last word, whatever
    # the wheels have against it.
    never = replace(PARAMS.relative, inliers=2.0)
    rescue = replace(PARAMS.rescue, margin=-1.0)
    engine.params = replace(PARAMS, relative=never, settled=never, rescue=rescue)
    truth, believed = Pose2(0.6, 0.1, 0.0), Pose2(0.61, 0.13, 0.01)
    result = engine.update(request(cloud_at(corridor(), truth, rng, sigma_m=0.01), believed))
    assert (result.answer.rung, result.inserted) == (Rung.RESCUE, True)
    assert result.fix is not None
    assert result.fix.map_from_base.distance_to(truth) > 1.0
    joined = engine.map.path[-1][1]
    assert abs(joined.x_m - believed.x_m) < 0.01
    assert abs(joined.y_m - truth.y_m) < 0.005
    assert abs(joined.theta_rad - truth.theta_rad) < 0.005


def localizing(seed: int = 0) -> SlamEngine:
    return SlamEngine(PARAMS, mapped_lab(seed), "localization")


@pytest.mark.parametrize("known", [True, False])
def test_localization_finds_the_pose_and_leaves_the_map_alone(known: bool) -> None:
    engine, truth = localizing(), tour_poses(0)[20]
    scans, revision = len(engine.map.path), engine.map.revision
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01, stamp_ns=77)
    prior = truth @ Pose2(0.05, -0.05, 0.02) if known else None
    result = engine.update(request(cloud, prior, 4.0 * SURE))
    assert result.fix is not None
    assert result.fix.stamp_ns == 77
    assert result.fix.map_from_base.distance_to(truth) < 0.03
    assert result.fix.relocalized is not known
    assert np.all(np.linalg.eigvalsh(result.fix.covariance) > 0.0)
    off = result.fix.map_from_base.as_array() - truth.as_array()
    assert off @ inverse_matrix(result.fix.covariance) @ off < 25.0
    assert (result.inserted, len(engine.map.path)) == (False, scans)
    assert engine.map.revision == revision


def test_a_kidnapped_robot_is_found_and_said_to_be() -> None:
    truth, believed = tour_poses(0)[20], tour_poses(0)[50]
    cloud = cloud_at(lab(0), truth, np.random.default_rng(0), sigma_m=0.01)
    result = localizing().update(request(cloud, believed))
    assert result.answer.rung is Rung.ABSOLUTE
    assert result.fix is not None
    assert result.fix.relocalized
    assert result.fix.map_from_base.distance_to(truth) < 0.03


VAGUE = np.diag([0.64**2, 0.7**2, 0.94**2])


def test_what_fits_near_a_guess_is_weighed_against_the_whole_map() -> None:
    """Wheels that missed a turn: rooms look alike when turned by 90 degrees."""
    known, rng = mapped_lab(0), np.random.default_rng(3)
    engine = SlamEngine(PARAMS, known, "localization")
    for pose in tour_poses(0)[::6]:
        cloud = cloud_at(lab(0), pose, rng, sigma_m=0.01)
        result = engine.update(request(cloud, pose @ Pose2(0.3, 0.1, math.radians(-72.0)), VAGUE))
        assert {answer.rung for answer in result.climbed} <= {Rung.ABSOLUTE, Rung.EXHAUSTIVE}
        assert result.fix is not None
        assert result.fix.relocalized
        assert result.fix.map_from_base.distance_to(pose) < 0.05


@pytest.mark.parametrize("sigma", [0.01, 0.03])
def test_a_fix_in_a_corridor_says_what_it_does_not_know(sigma: float) -> None:
    """The walls tell nothing along it: there, the fix must not claim more than its error shows."""
    rng, truth = np.random.default_rng(1), Pose2(0.5, -0.1, 0.1)
    covariance = np.diag([0.2**2, 0.1**2, math.radians(3.0) ** 2])
    grown = PointMap(MapParams())
    for x in np.arange(-6.0, 6.1, 0.6):
        pose = Pose2(x, 0.1, 0.0)
        grown.insert(cloud_at(corridor(), pose, rng, sigma_m=sigma), pose)
    engine = SlamEngine(PARAMS, grown, "localization")
    for _ in range(6):
        off = rng.multivariate_normal(np.zeros(3), covariance)
        believed = Pose2.from_array(truth.as_array() + off)
        cloud = cloud_at(corridor(), truth, rng, sigma_m=sigma)
        fix = engine.update(request(cloud, believed, covariance)).fix
        assert fix is not None
        assert abs(fix.map_from_base.y_m - truth.y_m) < 0.03
        assert fix.covariance[1, 1] < 0.03**2 < 0.06**2 < fix.covariance[0, 0]
        wrong = fix.map_from_base.as_array() - truth.as_array()
        assert wrong @ inverse_matrix(fix.covariance) @ wrong < 16.3


@pytest.mark.parametrize(("sigma_deg", "finds"), [(45.0, True), (130.0, False)])
@pytest.mark.parametrize("off_deg", [4.0, 176.0])
def test_wheels_that_slip_still_say_which_of_two_headings_is_the_likelier(
    sigma_deg: float, finds: bool, off_deg: float
) -> None:
    """In the middle of a bare room all looks the same once turned by half a circle."""
    engine, rng = mapping_engine(), np.random.default_rng(0)
    here = Pose2(4.0, 3.0, 0.3)
    engine.update(request(cloud_at(room(), here, rng, sigma_m=0.01), here))
    seen = here @ Pose2(0.05, 0.0, math.radians(2.0))
    believed = Pose2(seen.x_m, seen.y_m, seen.theta_rad + math.radians(off_deg))
    spread = np.diag([0.5**2, 0.5**2, math.radians(sigma_deg) ** 2])
    cloud = cloud_at(room(), seen, rng, sigma_m=0.01, stamp_ns=1)
    fix = engine.update(request(cloud, believed, spread)).fix
    assert (fix is not None) == finds
    if fix is not None:
        flipped = off_deg > 90.0
        likelier = seen.theta_rad + (math.pi if flipped else 0.0)
        assert abs(math.remainder(fix.map_from_base.theta_rad - likelier, math.tau)) < 0.02


@pytest.mark.parametrize("mode", ["mapping", "localization"])
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    "points",
    [np.empty((0, 2)), np.array([[1.0, 0.0], [1.0, 0.1], [1.0, 0.2]])],
    ids=["empty", "three points"],
)
def test_useless_clouds_are_answered_with_a_reason(mode: str, known: bool, points: Array) -> None:
    truth, rng = tour_poses(0)[20], np.random.default_rng(0)
    if mode == "localization":
        engine = localizing()
    else:
        engine = mapping_engine()
        engine.update(request(cloud_at(lab(0), truth, rng, sigma_m=0.01), truth))
    scans = len(engine.map.path)
    far = Pose2(truth.x_m + 0.5, truth.y_m, truth.theta_rad)
    result: SlamResult = engine.update(request(plain_cloud(points), far if known else None))
    assert (result.fix, result.inserted) == (None, False)
    assert result.answer.verdict is not Verdict.ACCEPTED
    assert result.answer.reason
    assert len(engine.map.path) == scans


def test_mapping_without_a_pose_founds_no_map() -> None:
    engine = mapping_engine()
    cloud = cloud_at(lab(0), tour_poses(0)[0], np.random.default_rng(0))
    result = engine.update(request(cloud, None))
    assert (result.fix, result.inserted, len(engine.map)) == (None, False, 0)
    assert result.answer.reason
