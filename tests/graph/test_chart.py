from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from labs import cloud_at, lab, tour_poses

from amr_slam.engine import SlamEngine
from amr_slam.evaluation import align_se2
from amr_slam.geometry import Array, Pose2
from amr_slam.graph.chart import Chart
from amr_slam.graph.posegraph import Edge
from amr_slam.graph.submaps import Submaps
from amr_slam.map import PointMap
from amr_slam.map.file import decode, encode
from amr_slam.params import SlamParams
from amr_slam.simulation import World, plan_tour
from amr_slam.simulation.buildings import alike_rooms

PARAMS = SlamParams()
# A step's own uncertainty as the registration claims it; the drift below is a bias beside it.
STEP = np.diag([0.02**2, 0.02**2, 0.01**2])
DRIFT = Pose2(0.004, 0.0, math.radians(0.25))
"""Of each step of 0.6 m: 40 degrees in 100 m, far worse than scans registered in a submap."""
SLIGHT = Pose2(0.002, 0.0, math.radians(0.05))


# All that is farther than the way just driven is recalled by pieces.
FAR = replace(PARAMS.closing, most_m=0.6, rival_way_m=12.0, recall_step_m=2.0, piece_m=6.0)
RECALLING = replace(PARAMS, closing=FAR)


def charted(
    world: World, truth: Sequence[Pose2], drift: Pose2, params: SlamParams = PARAMS
) -> tuple[Chart, list[int]]:
    """The chart of a drive whose every step is off by ``drift``; and at which nodes it moved."""
    chart, rng, moved = Chart(params), np.random.default_rng(5), []
    for row, pose in enumerate(truth):
        cloud = cloud_at(world, pose, rng, sigma_m=0.01, stamp_ns=row)
        believed = truth[0]
        if row:
            believed = chart.newest @ (truth[row - 1].inverse() @ pose) @ drift
        if chart.insert(cloud, believed, STEP) is not None:
            moved.append(row)
    return chart, moved


def ate_m(poses: Array, truth: Sequence[Pose2]) -> float:
    true = np.array([pose.as_array() for pose in truth])
    off = (align_se2(poses, true) @ poses[:, :2]) - true[:, :2]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def false_loops(edges: Sequence[Edge], truth: Sequence[Pose2]) -> list[Edge]:
    false = []
    for edge in edges:
        off = (truth[edge.start].inverse() @ truth[edge.end]).inverse() @ edge.delta
        if edge.loop and (math.hypot(off.x_m, off.y_m) > 0.3 or abs(off.theta_rad) > 0.1):
            false.append(edge)
    return false


def test_the_second_round_takes_the_drift_of_the_first_away() -> None:
    truth = [*tour_poses(0), *tour_poses(0)[:40]]
    chart, moved = charted(lab(0), truth, DRIFT)
    alone = [truth[0]]
    for before, after in itertools.pairwise(truth):
        alone.append(alone[-1] @ (before.inverse() @ after) @ DRIFT)
    drifted = ate_m(np.array([pose.as_array() for pose in alone]), truth)
    assert sum(edge.loop for edge in chart.edges) > 4
    assert false_loops(chart.edges, truth) == []
    assert ate_m(chart.poses, truth) < 0.25 * drifted
    assert moved
    # What grows has moved along: the next scan is registered where the pose now is.
    expected = chart.local.path[-1][1]
    assert expected.distance_to(chart.newest) < 1e-6


def test_a_piece_of_the_way_is_recalled_and_the_chart_outlives_its_process() -> None:
    truth = [*tour_poses(0), *tour_poses(0)[:40]]
    engine = SlamEngine(RECALLING, PointMap(PARAMS.map), "mapping")
    engine.chart, _ = charted(lab(0), truth, SLIGHT, RECALLING)
    loops = [edge for edge in engine.chart.edges if edge.loop]
    assert len(loops) >= 3
    assert false_loops(loops, truth) == []
    # Saved and loaded, it is tied as before, and goes on.
    rng = np.random.default_rng(5)
    for row, pose in enumerate(engine.chart.poses):
        cloud = cloud_at(lab(0), truth[row], rng, sigma_m=0.01, stamp_ns=row)
        engine.map.append(cloud, Pose2.from_array(pose))
    engine.settle()
    loaded, _ = decode(encode(engine.map)[0])
    again = SlamEngine(RECALLING, loaded, "mapping", resumed=True).chart
    assert again is not None
    np.testing.assert_allclose(again.poses, engine.chart.poses, atol=1e-12)
    assert [(e.start, e.end, e.loop) for e in again.edges] == [
        (e.start, e.end, e.loop) for e in engine.chart.edges
    ]
    assert len(again.local) > 100
    again.insert(cloud, again.newest @ Pose2(0.3, 0.0, 0.0), STEP)
    assert len(again.poses) == len(truth) + 1


@pytest.mark.parametrize(("seed", "params"), [(0, PARAMS), (1, RECALLING)])
def test_rooms_that_look_alike_are_not_taken_for_one_another(seed: int, params: SlamParams) -> None:
    world = alike_rooms(seed, 400.0)
    path = plan_tour(world).path_m
    ahead = np.roll(path, -4, axis=0) - path
    truth = [
        Pose2(path[i, 0], path[i, 1], math.atan2(ahead[i, 1], ahead[i, 0]))
        for i in range(0, len(path), 20)
    ]
    chart, _ = charted(world, truth, SLIGHT, params)
    assert false_loops(chart.edges, truth) == []


def test_the_map_and_what_is_anchored_follow() -> None:
    truth, rng = [*tour_poses(0), *tour_poses(0)[:40]], np.random.default_rng(5)
    engine = SlamEngine(PARAMS, PointMap(PARAMS.map), "mapping")
    chart, beside = engine.chart, Pose2(0.2, 0.1, 0.3)
    assert chart is not None
    for row, pose in enumerate(truth):
        cloud = cloud_at(lab(0), pose, rng, sigma_m=0.01, stamp_ns=row)
        believed = truth[0]
        if row:
            believed = chart.newest @ (truth[row - 1].inverse() @ pose) @ DRIFT
        engine.join(cloud, believed, STEP)
        if row == 60:
            then, anchor = believed @ beside, engine.anchored(believed @ beside)
    now = engine.unanchored(*anchor)
    assert now.distance_to(then) > 0.2
    assert now.distance_to(chart.pose(60) @ beside) < 1e-9
    revision, scans = engine.map.revision, len(engine.map.path)
    assert engine.map.path[60][1].distance_to(chart.pose(60)) > 0.2
    engine.settle()
    assert engine.map.revision == revision + 1
    assert len(engine.map.path) == scans
    for (_, settled), row in zip(engine.map.path, chart.poses, strict=True):
        assert settled.distance_to(Pose2.from_array(row)) < 1e-9
    engine.settle()  # nothing has moved since
    assert engine.map.revision == revision + 1


def test_what_grows_follows_what_is_finished_keeps_its_shape() -> None:
    rng = np.random.default_rng(0)
    poses = [Pose2(0.6 * n, 0.0, 0.0) for n in range(8)]
    submaps = Submaps(replace(PARAMS, closing=replace(PARAMS.closing, submap_m=3.0)))
    for row, pose in enumerate(poses):
        cloud = cloud_at(lab(0), tour_poses(0)[row], rng, sigma_m=0.01, stamp_ns=row)
        submaps.insert(row, cloud, pose, [0.6 * n for n in range(row + 1)])
    (finished,) = submaps.finished
    shape = finished.poses.copy()
    moved = np.array([(Pose2(1.0, 2.0, 0.5) @ pose).as_array() for pose in poses])
    submaps.move(moved)
    np.testing.assert_array_equal(finished.poses, shape)
    assert finished.map_from_submap(moved).distance_to(Pose2(1.0, 2.0, 0.5)) < 1e-9
    for stamp_ns, pose in submaps.local.path:
        assert pose.distance_to(Pose2.from_array(moved[stamp_ns])) < 1e-9


def test_one_witness_closes_nothing() -> None:
    truth = [*tour_poses(0), *tour_poses(0)[:40]]
    never = replace(PARAMS.closing, apart_m=(100.0, 200.0))
    chart = Chart(replace(PARAMS, closing=never))
    rng = np.random.default_rng(5)
    for row, pose in enumerate(truth):
        moved = chart.insert(cloud_at(lab(0), pose, rng, sigma_m=0.01, stamp_ns=row), pose, STEP)
        assert moved is None
    assert not any(edge.loop for edge in chart.edges)
