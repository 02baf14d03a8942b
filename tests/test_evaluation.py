from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import SHARED

from amr_slam.evaluation import (
    ErrorSummary,
    absolute_trajectory_error,
    align_se2,
    associate,
    error95_coverage,
    nees,
    poses_at,
    relations_error,
)
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.recording import Relations, Trajectory, read_relations, read_tum

LOGS = SHARED / "data" / "logs"
fixed = settings(derandomize=True, deadline=None, max_examples=60)
moves = st.builds(Pose2, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
seeds = st.integers(0, 2**32 - 1)


def walk(seed: int, count: int = 40) -> Trajectory:
    rng = np.random.default_rng(seed)
    poses = np.column_stack(
        [np.cumsum(rng.normal(size=(count, 2)), axis=0), rng.uniform(-3.1, 3.1, count)]
    )
    return Trajectory(stamps_ns=np.arange(count) * 100_000_000, poses=poses)


def moved(trajectory: Trajectory, by: Pose2) -> Trajectory:
    poses = [(by @ Pose2.from_array(row)).as_array() for row in trajectory.poses]
    return Trajectory(stamps_ns=trajectory.stamps_ns, poses=np.array(poses))


def disturbed(trajectory: Trajectory, offset: Array) -> Trajectory:
    return Trajectory(stamps_ns=trajectory.stamps_ns, poses=trajectory.poses + offset)


def test_summary_of_known_errors() -> None:
    summary = ErrorSummary.of(np.array([3.0, -4.0, 0.0, 0.0]))
    assert summary.rms == 2.5
    assert (summary.mean, summary.median, summary.max) == (1.75, 1.5, 4.0)
    assert summary.p95 == pytest.approx(3.85)
    with pytest.raises(ValueError, match="no errors"):
        ErrorSummary.of(np.empty(0))


@fixed
@given(seed=seeds, move=moves)
def test_alignment_undoes_any_rigid_motion(seed: int, move: Pose2) -> None:
    reference = walk(seed)
    result = absolute_trajectory_error(moved(reference, move), reference)
    assert result.position_m.max < 1e-9
    assert result.heading_deg.max < 1e-6
    assert result.matched == len(reference)
    back = result.reference_from_estimate @ move
    assert np.abs(back.log()).max() < 1e-9


@fixed
@given(seed=seeds, first=moves, second=moves)
def test_aligned_error_does_not_depend_on_the_frames(
    seed: int, first: Pose2, second: Pose2
) -> None:
    reference = walk(seed)
    noise = np.random.default_rng(seed).normal(0.0, 0.2, reference.poses.shape)
    estimate = disturbed(reference, noise)
    plain = absolute_trajectory_error(estimate, reference)
    other = absolute_trajectory_error(moved(estimate, first), moved(reference, second))
    assert other.position_m.rms == pytest.approx(plain.position_m.rms, abs=1e-9)
    assert other.heading_deg.rms == pytest.approx(plain.heading_deg.rms, abs=1e-6)
    unaligned = absolute_trajectory_error(estimate, reference, align=False)
    assert plain.position_m.rms <= unaligned.position_m.rms + 1e-12


@fixed
@given(seed=seeds, turn=st.floats(-0.01, 0.01), x=st.floats(-0.01, 0.01))
def test_no_other_alignment_is_better(seed: int, turn: float, x: float) -> None:
    reference = walk(seed)
    noise = np.random.default_rng(seed).normal(0.0, 0.2, reference.poses.shape)
    estimate = reference.poses + noise

    def squares(alignment: Pose2) -> float:
        return float(np.sum((alignment @ estimate[:, :2] - reference.poses[:, :2]) ** 2))

    best = align_se2(estimate, reference.poses)
    assert squares(best) <= squares(Pose2(x, -x, turn) @ best) + 1e-9


def test_unaligned_error_is_the_plain_difference() -> None:
    reference = walk(1)
    estimate = disturbed(reference, np.array([0.3, 0.4, math.radians(2.0)]))
    result = absolute_trajectory_error(estimate, reference, align=False)
    for size in (result.position_m.rms, result.position_m.median, result.position_m.max):
        assert size == pytest.approx(0.5)
    assert result.heading_deg.mean == pytest.approx(2.0)
    assert result.reference_from_estimate == Pose2.identity()


def test_a_standing_robot_is_aligned_by_its_headings() -> None:
    standing = np.tile([1.0, 2.0, 3.0], (5, 1))
    alignment = align_se2(standing, np.tile([4.0, 4.0, -3.0], (5, 1)))
    expected = Pose2(4.0, 4.0, -3.0) @ Pose2(1.0, 2.0, 3.0).inverse()
    assert np.abs((alignment.inverse() @ expected).log()).max() < 1e-12


def test_poses_between_stamps_turn_the_short_way_and_gaps_have_none() -> None:
    trajectory = Trajectory(
        stamps_ns=np.array([0, 100, 100, 200, 10_000_000_000]),
        poses=np.array([[0, 0, 3.1], [1, 2, -3.1], [1, 2, -3.1], [3, 2, -3.1], [9, 9, 0.0]]),
    )
    stamps = np.array([-1, 0, 50, 100, 150, 300, 10_000_000_000, 10_000_000_001])
    poses, valid = poses_at(trajectory, stamps, 1.0)
    assert valid.tolist() == [False, True, True, True, True, False, True, False]
    np.testing.assert_allclose(poses[2, :2], [0.5, 1.0])
    assert abs(wrap_angle(float(poses[2, 2]) - math.pi)) < 1e-12
    np.testing.assert_allclose(poses[4], [2.0, 2.0, -3.1])
    assert np.isnan(poses[~valid]).all()


def test_association_without_common_time_is_an_error() -> None:
    early = walk(1)
    late = Trajectory(stamps_ns=early.stamps_ns + 10**12, poses=early.poses)
    assert len(associate(early, late)[0]) == 0
    empty = Trajectory(stamps_ns=np.empty(0, dtype=np.int64), poses=np.empty((0, 3)))
    for estimate in (early, empty):
        with pytest.raises(ValueError, match="no time in common"):
            absolute_trajectory_error(estimate, late)


@fixed
@given(seed=seeds, move=moves)
def test_relations_need_no_common_frame(seed: int, move: Pose2) -> None:
    truth = walk(seed)
    starts, ends = np.arange(0, 30), np.arange(10, 40)
    deltas = [
        (truth.pose(int(i)).inverse() @ truth.pose(int(j))).as_array()
        for i, j in zip(starts, ends, strict=True)
    ]
    relations = Relations(
        start_ns=truth.stamps_ns[starts],
        end_ns=truth.stamps_ns[ends],
        start_from_end=np.array(deltas),
    )
    result = relations_error(moved(truth, move), relations)
    assert result.position_m.max < 1e-9
    assert result.heading_deg.max < 1e-6
    assert (result.matched, result.total) == (30, 30)
    wrong = Relations(
        start_ns=relations.start_ns,
        end_ns=relations.end_ns + 10**12 * (np.arange(30) < 7),
        start_from_end=relations.start_from_end + np.array([0.0, 0.0, 0.1]),
    )
    result = relations_error(truth, wrong)
    assert result.matched == 23
    assert result.heading_deg.median == pytest.approx(math.degrees(0.1))


def test_honest_covariances_give_their_dimension_and_coverage() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3))
    covariance = root @ root.T
    errors = rng.multivariate_normal(np.zeros(3), covariance, 20_000)
    covariances = np.broadcast_to(covariance, (20_000, 3, 3))
    assert np.mean(nees(errors, covariances)) == pytest.approx(3.0, rel=0.03)
    assert np.mean(nees(2.0 * errors, covariances)) == pytest.approx(12.0, rel=0.03)


def test_coverage_counts_errors_within_their_bounds() -> None:
    assert error95_coverage(np.array([0.1, -0.2, 0.3, 0.4]), np.array([0.1, 0.2, 0.2, 0.5])) == 0.75
    with pytest.raises(ValueError, match="no errors"):
        error95_coverage(np.empty(0), np.empty(0))


@pytest.mark.skipif(not LOGS.is_dir(), reason="public robot logs are not here")
def test_the_reference_of_a_real_log_agrees_with_its_relations() -> None:
    reference = read_tum(LOGS / "intel.corrected.tum")
    relations = read_relations(LOGS / "intel.relations")
    result = relations_error(reference, relations, max_gap_s=2.0)
    assert result.total == 1523
    assert result.matched > 300
    assert result.position_m.median < 0.1
