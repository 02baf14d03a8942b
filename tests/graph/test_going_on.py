"""A map's pose graph outlives the engine that made it: it is exported, and gone on with."""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import pytest
from labs import cloud_at, lab, tour_poses

from amr_slam.cli import main
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap, save_map
from amr_slam.map.file import decode, encode
from amr_slam.params import SlamParams
from amr_slam.slam_request import SlamRequest, SlamResult

PARAMS = SlamParams()
STEP = np.diag([0.02**2, 0.02**2, 0.01**2])
DRIFT = Pose2(0.002, 0.0, math.radians(0.08))
TOUR = tour_poses(0, 0.9)
SECOND_ROUND = 10


def cloud(number: int) -> tuple[SlamRequest, Pose2]:
    """The scan of a step of the tour, which begins anew after its end, and its true pose."""
    pose = TOUR[number % len(TOUR)]
    rng = np.random.default_rng(number)
    seen = cloud_at(lab(0), pose, rng, sigma_m=0.01, stamp_ns=number)
    return SlamRequest(cloud=seen, map_from_base=pose, covariance=25.0 * STEP), pose


def drive(engine: SlamEngine, numbers: range, pose: Pose2 | None = None) -> None:
    """Scans join by steps that drift, from where the chart is or from ``pose``."""
    for number in numbers:
        request, true = cloud(number)
        if pose is None:
            believed = true
        else:
            believed = pose @ (cloud_pose(number - 1).inverse() @ true) @ DRIFT
        engine.join(request.cloud, believed, STEP)
        assert engine.chart is not None
        pose = engine.chart.newest


def cloud_pose(number: int) -> Pose2:
    return TOUR[number % len(TOUR)]


@functools.cache
def once_round() -> PointMap:
    """The tour of a laboratory and the beginning of a second one, with the loops that it closed.
    Nobody may insert."""
    engine = SlamEngine(PARAMS, PointMap(PARAMS.map, "round"), "mapping")
    drive(engine, range(len(TOUR) + SECOND_ROUND))
    engine.settle()
    return engine.map


def loaded() -> PointMap:
    return decode(encode(once_round())[0])[0]


def test_g2o_holds_the_graph_as_others_read_it(tmp_path: Path) -> None:
    known = once_round()
    save_map(known, tmp_path / "round.amrmap")
    out = tmp_path / "round.g2o"
    assert main(["map", "export", str(tmp_path / "round.amrmap"), "--out", str(out)]) == 0
    poses: dict[int, Array] = {}
    edges: list[tuple[int, int, Array, Array]] = []
    fixed: list[int] = []
    for line in out.read_text("ascii").splitlines():
        tag, *fields = line.split(" ")
        if tag == "VERTEX_SE2":
            poses[int(fields[0])] = np.array(fields[1:], dtype=float)
        elif tag == "EDGE_SE2":
            values = np.array(fields[2:], dtype=float)
            xx, xy, xt, yy, yt, tt = values[3:]
            information = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
            edges.append((int(fields[0]), int(fields[1]), values[:3], information))
        else:
            assert tag == "FIX"
            fixed.append(int(fields[0]))
    assert fixed == [0]
    assert sorted(poses) == list(range(len(known.path)))
    ways = [abs(end - start) for start, end, _, _ in edges]
    assert ways.count(1) >= len(poses) - 1
    assert sum(way > len(TOUR) // 2 for way in ways) >= 2  # the loops
    worst = 0.0
    told = [one[3] for one in edges]
    np.testing.assert_allclose(told, known.ties.informations, rtol=1e-6, atol=1e-6)
    for start, end, delta, information in edges:
        a, b = poses[start], poses[end]
        c, s = math.cos(a[2]), math.sin(a[2])
        off = np.array([[c, s], [-s, c]]) @ (b[:2] - a[:2]) - delta[:2]
        turn = math.remainder(b[2] - a[2] - delta[2], math.tau)
        error = np.array([*off, turn])
        assert np.linalg.eigvalsh(information)[0] > 0.0
        worst = max(worst, float(error @ information @ error))
    # The poses are those that these edges ask for: none is off by much more than it may be.
    assert worst < 30.0


def test_mapping_goes_on_with_the_graph_where_it_was_cut_off() -> None:
    engine = SlamEngine(PARAMS, loaded(), "localization")
    assert engine.chart is None
    engine.go_on()
    first = len(TOUR) + SECOND_ROUND
    result = asked(engine, first)
    assert result.inserted
    assert engine.chart is not None
    before = sum(edge.loop for edge in engine.chart.edges)
    drive(engine, range(first + 1, first + 12), engine.chart.newest)
    assert sum(edge.loop for edge in engine.chart.edges) > before
    engine.settle()
    ties = engine.map.ties
    steps = ties.ends[~ties.loops & (ties.ends == ties.starts + 1)]
    assert len(steps) == len(engine.map.path) - 1
    off = engine.map.path[-1][1].distance_to(cloud_pose(first + 11))
    assert off < 0.15  # 12 steps that drift, since the last loop


@pytest.mark.parametrize("hold", [False, True])
def test_elsewhere_or_held_the_map_is_gone_on_with_as_it_is(hold: bool) -> None:
    engine = SlamEngine(PARAMS, loaded(), "localization")
    engine.go_on(hold=hold)
    number = len(TOUR) + SECOND_ROUND if hold else farthest()
    scans = len(engine.map.path)
    assert asked(engine, number).inserted
    assert engine.chart is None
    assert len(engine.map.path) == scans + 1


def farthest() -> int:
    end = cloud_pose(len(TOUR) + SECOND_ROUND)
    away = [pose.distance_to(end) for pose in TOUR]
    return int(np.argmax(away))


def asked(engine: SlamEngine, number: int) -> SlamResult:
    request, _ = cloud(number)
    return engine.update(request)
