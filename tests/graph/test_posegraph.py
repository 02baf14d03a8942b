from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.graph.posegraph import Edge, optimize

STEP = np.diag([0.02, 0.02, 0.01]) ** 2


def ring(count: int, radius_m: float = 20.0) -> list[Pose2]:
    """Once round a circle, the first pose in the origin."""
    poses = []
    for angle in np.linspace(0.0, 2.0 * math.pi, count, endpoint=False):
        x, y = radius_m * math.sin(angle), radius_m * (1.0 - math.cos(angle))
        poses.append(Pose2(x, y, wrap_angle(float(angle))))
    return poses


def edge(poses: list[Pose2], a: int, b: int, error: Array, *, loop: bool = False) -> Edge:
    delta = (poses[a].inverse() @ poses[b]).as_array() + error
    information = np.linalg.inv(STEP)
    return Edge(start=a, end=b, delta=Pose2.from_array(delta), information=information, loop=loop)


def driven(truth: list[Pose2], rng: np.random.Generator) -> tuple[Array, list[Edge]]:
    """The way that noisy steps (of ``STEP``, and bent by 2 mrad each) make, and these steps."""
    bend = np.array([0.0, 0.0, 0.002])
    edges = [
        edge(truth, k, k + 1, rng.multivariate_normal(bend, STEP)) for k in range(len(truth) - 1)
    ]
    poses = list(itertools.accumulate((e.delta for e in edges), lambda a, b: a @ b,
                                      initial=truth[0]))  # fmt: skip
    return np.array([pose.as_array() for pose in poses]), edges


def worst_m(poses: Array, truth: list[Pose2]) -> float:
    true = np.array([pose.as_array() for pose in truth])
    return float(np.hypot(*(poses - true)[:, :2].T).max())


def test_a_loop_takes_the_drift_away() -> None:
    truth = ring(120)
    poses, edges = driven(truth, np.random.default_rng(1))
    loops = [edge(truth, k, 110 + k, np.zeros(3), loop=True) for k in range(8)]
    before, after = worst_m(poses, truth), worst_m(optimize(poses, [*edges, *loops]), truth)
    assert before > 3.0
    assert after < 0.3 * before


def test_a_false_loop_does_not_bend_what_true_ones_hold() -> None:
    truth = ring(120)
    poses, edges = driven(truth, np.random.default_rng(2))
    true = [edge(truth, k, 110 + k, np.zeros(3), loop=True) for k in range(8)]
    false = edge(truth, 30, 70, np.array([8.0, -3.0, 0.5]), loop=True)
    good = optimize(poses, [*edges, *true])
    assert np.abs(optimize(poses, [*edges, *true, false]) - good).max() < 0.05


def test_what_agrees_stays_and_the_first_pose_is_the_anchor() -> None:
    truth = ring(40)
    exact = np.array([pose.as_array() for pose in truth])
    edges = [edge(truth, k, k + 1, np.zeros(3)) for k in range(39)]
    found = optimize(exact, [*edges, edge(truth, 0, 39, np.zeros(3), loop=True)])
    np.testing.assert_allclose(found, exact, atol=1e-9)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    x=st.floats(-50.0, 50.0),
    y=st.floats(-50.0, 50.0),
    theta=st.floats(-3.1, 3.1),
    seed=st.integers(0, 1000),
)
def test_the_frame_does_not_matter(x: float, y: float, theta: float, seed: int) -> None:
    """Edges speak of pairs: the same graph elsewhere has the same solution there."""
    truth = ring(30)
    poses, edges = driven(truth, np.random.default_rng(seed))
    loops = [edge(truth, 0, 29, np.zeros(3), loop=True)]
    here = optimize(poses, [*edges, *loops])
    frame = Pose2(x, y, theta)
    moved = np.array([(frame @ Pose2.from_array(row)).as_array() for row in poses])
    there = optimize(moved, [*edges, *loops])
    back = np.array([(frame.inverse() @ Pose2.from_array(row)).as_array() for row in there])
    off = back - here
    off[:, 2] = wrap_angle(off[:, 2])
    assert np.abs(off).max() < 1e-5


@pytest.mark.parametrize("count", [1, 2])
def test_there_is_nothing_to_improve_without_loops(count: int) -> None:
    truth = ring(10)[:count]
    poses, edges = driven(truth, np.random.default_rng(0))
    np.testing.assert_allclose(optimize(poses, edges), poses, atol=1e-9)
