from __future__ import annotations

import itertools
import math

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.graph.drift import Ties
from amr_slam.graph.posegraph import Edge
from amr_slam.params import DriftParams

PARAMS = DriftParams(heading_radpsqrtm=0.01, scale=0.0, place_m=0.001)
CORNER = 30


def way() -> list[Pose2]:
    """East, and from the corner on north, a metre each."""
    east = [Pose2(float(n), 0.0, 0.0) for n in range(CORNER)]
    return [*east, *(Pose2(float(CORNER), float(n), 0.5 * math.pi) for n in range(CORNER + 10))]


def edges(poses: list[Pose2], *loops: tuple[int, int]) -> list[Edge]:
    pairs = [*((row, row + 1) for row in range(len(poses) - 1)), *loops]
    return [
        Edge(
            start=a,
            end=b,
            delta=poses[a].inverse() @ poses[b],
            information=np.eye(3),
            loop=b != a + 1,
        )
        for a, b in pairs
    ]


def drifted(poses: list[Pose2], rng: np.random.Generator) -> Array:
    """(3,) the first node's pose as the newest one sees it when each metre turns by chance."""
    seen = Pose2.identity()
    for before, after in itertools.pairwise(poses):
        step = before.inverse() @ after
        length = math.hypot(step.x_m, step.y_m)
        turn = rng.normal(0.0, PARAMS.heading_radpsqrtm * math.sqrt(max(length, 0.05)))
        seen = seen @ Pose2(0.5 * step.x_m, 0.5 * step.y_m, 0.0)
        seen = seen @ Pose2(0.0, 0.0, turn)
        seen = seen @ Pose2(0.5 * step.x_m, 0.5 * step.y_m, step.theta_rad)
    return (poses[-1] @ seen.inverse()).as_array()


def test_what_is_told_is_what_chance_makes_of_the_way() -> None:
    poses, rng = way(), np.random.default_rng(0)
    ties = Ties()
    ties.add(edges(poses))
    told = ties.drift(np.array([pose.as_array() for pose in poses]), PARAMS)
    found = np.array([drifted(poses, rng) for _ in range(1500)])
    assert told.ways_m[0] == 69.0
    np.testing.assert_allclose(told.headings_rad[0], found[:, 2].std(), rtol=0.1)
    np.testing.assert_allclose(told.places_m2[0], np.cov(found[:, :2].T), rtol=0.15)
    # Sideways of what was driven, not along it: the node before last is as far off as a step.
    assert told.places_m2[-2, 0, 0] < 1e-3


def test_a_loop_is_a_shorter_way() -> None:
    poses = way()
    ties = Ties()
    ties.add(edges(poses, (3, 60)))
    told = ties.drift(np.array([pose.as_array() for pose in poses]), PARAMS)
    assert told.ways_m[3] < 10.0
    assert 20.0 < told.ways_m[CORNER] < 45.0
    assert told.ways_m[-1] == told.headings_rad[-1] == 0.0
