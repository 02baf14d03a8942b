from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.fusion.trail import Trail
from amr_slam.geometry import Pose2
from amr_slam.odometry import DifferentialDrive, Odometry, PoseOdometry
from amr_slam.samples import Motion, OdometrySample, WheelSample

DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
POSES = PoseOdometry()
STEP_NS = 100_000_000

# What a drive of 2 m/s and 3 rad/s can do in a tenth of a second.
forward_m = st.floats(-0.15, 0.15)
turn_rad = st.floats(-0.2, 0.2)


def wheels(stamp_ns: int, left_m: float, right_m: float, segment: int = 0) -> WheelSample:
    return WheelSample(
        stamp_ns=stamp_ns, left_rad=left_m / 0.1, right_rad=right_m / 0.1, segment=segment
    )


def pose(stamp_ns: int, odom_from_base: Pose2, segment: int = 0) -> OdometrySample:
    return OdometrySample(stamp_ns=stamp_ns, odom_from_base=odom_from_base, segment=segment)


def step(odometry: Odometry, forward: float, turn: float, pieces: int = 1) -> Motion:
    """One arc within a tenth of a second, read in ``pieces`` and composed again."""
    trail = Trail(0)
    samples: list[WheelSample | OdometrySample] = []
    for i in range(pieces + 1):
        stamp, part = STEP_NS * i // pieces, i / pieces
        left, right = part * (forward - 0.25 * turn), part * (forward + 0.25 * turn)
        if odometry is DRIVE:
            samples.append(wheels(stamp, left, right))
        else:
            start = Pose2(3.0, -2.0, 2.5)
            samples.append(pose(stamp, start @ Pose2.exp([part * forward, 0.0, part * turn])))
    for previous, current in pairwise(samples):
        trail.append(odometry.motion(previous, current))
    return trail.between(0, STEP_NS)


@pytest.mark.parametrize("odometry", [DRIVE, POSES], ids=["wheels", "poses"])
@settings(derandomize=True, deadline=None, max_examples=50)
@given(forward=forward_m, turn=turn_rad, pieces=st.integers(2, 20))
def test_a_step_cut_into_pieces_is_the_same_motion(
    odometry: Odometry, forward: float, turn: float, pieces: int
) -> None:
    whole, cut = step(odometry, forward, turn), step(odometry, forward, turn, pieces)
    assert not whole.gap
    np.testing.assert_allclose(cut.delta.as_array(), whole.delta.as_array(), atol=1e-12)
    scale = np.abs(whole.covariance).max()
    np.testing.assert_allclose(cut.covariance, whole.covariance, rtol=0.01, atol=0.01 * scale)
    diagonal = np.diag(whole.covariance)
    np.testing.assert_allclose(np.diag(cut.covariance), diagonal, rtol=0.01, atol=1e-15)


@settings(derandomize=True, deadline=None)
@given(forward=forward_m, turn=turn_rad)
def test_wheels_and_poses_tell_the_same_arc_and_valid_covariances(
    forward: float, turn: float
) -> None:
    expected = Pose2.exp([forward, 0.0, turn]).as_array()
    for odometry in (DRIVE, POSES):
        motion = step(odometry, forward, turn)
        np.testing.assert_allclose(motion.delta.as_array(), expected, atol=1e-12)
        np.testing.assert_allclose(motion.covariance, motion.covariance.T, atol=1e-18)
        assert np.linalg.eigvalsh(motion.covariance)[0] >= -1e-15


@pytest.mark.parametrize("odometry", [DRIVE, POSES], ids=["wheels", "poses"])
def test_standing_adds_nothing(odometry: Odometry) -> None:
    motion = step(odometry, 0.0, 0.0, pieces=5)
    assert motion.delta == Pose2.identity()
    assert not motion.covariance.any()


def test_the_noise_of_the_wheels_is_that_of_the_covariance() -> None:
    """Monte Carlo of the law itself: each wheel's increment is off by k times its travel."""
    rng = np.random.default_rng(1)
    drive = DifferentialDrive(
        radius_left_m=0.1, radius_right_m=0.1, track_m=0.5, yaw_rad2_per_m=0.0
    )
    pieces, left, right = 20, 0.02, 0.14
    said = drive.motion(wheels(0, 0.0, 0.0), wheels(STEP_NS, left, right))
    errors = []
    for _ in range(2000):
        end = Pose2.identity()
        for _ in range(pieces):
            dl = left / pieces + rng.normal(0.0, math.sqrt(1e-4 * left / pieces))
            dr = right / pieces + rng.normal(0.0, math.sqrt(1e-4 * right / pieces))
            end = end @ Pose2.exp([0.5 * (dl + dr), 0.0, (dr - dl) / 0.5])
        errors.append((said.delta.inverse() @ end).as_array())
    seen = np.cov(np.array(errors).T)
    # Off-diagonals against the standard deviations: 2000 draws tell about 5 %.
    sigma = np.sqrt(np.diag(said.covariance))
    assert np.abs((seen - said.covariance) / np.outer(sigma, sigma)).max() < 0.12


@pytest.mark.parametrize(
    "current",
    [
        wheels(STEP_NS, 0.01, 0.01, segment=1),
        wheels(STEP_NS, 6.0, 6.0),
        wheels(STEP_NS, 0.2, -0.2),
        wheels(STEP_NS, math.nan, 0.0),
        wheels(STEP_NS, 0.0, math.inf),
    ],
    ids=["segment", "too fast", "turns too fast", "nan", "inf"],
)
def test_what_wheels_cannot_tell_is_a_gap(current: WheelSample) -> None:
    motion = DRIVE.motion(wheels(0, 0.0, 0.0), current)
    assert motion.gap
    assert motion.delta == Pose2.identity()
    reach_m, reach_rad = 2.0 * (0.1 + 0.02), 3.0 * (0.1 + 0.02)
    expected = np.diag([reach_m**2, reach_m**2, reach_rad**2])
    np.testing.assert_allclose(motion.covariance, expected, rtol=1e-12)
    np.testing.assert_array_equal(motion.covariance, DRIVE.silence(0, STEP_NS).covariance)


@pytest.mark.parametrize(
    "current",
    [
        pose(STEP_NS, Pose2(0.01, 0.0, 0.0), segment=1),
        pose(STEP_NS, Pose2(5.0, 0.0, 0.0)),
        pose(STEP_NS, Pose2(0.0, 0.0, 2.0)),
        pose(STEP_NS, Pose2(math.nan, 0.0, 0.0)),
        pose(STEP_NS, Pose2(0.0, 0.0, math.inf)),
    ],
    ids=["segment", "too fast", "turns too fast", "nan", "inf"],
)
def test_what_poses_cannot_tell_is_a_gap(current: OdometrySample) -> None:
    motion = POSES.motion(pose(0, Pose2.identity()), current)
    assert motion.gap
    assert motion.delta == Pose2.identity()
    np.testing.assert_array_equal(motion.covariance, POSES.silence(0, STEP_NS).covariance)


def test_a_turn_on_the_spot_at_full_rate_is_no_fault() -> None:
    wheel_m = 2.9 * 0.1 * 0.25
    motion = DRIVE.motion(wheels(0, 0.0, 0.0), wheels(STEP_NS, -wheel_m, wheel_m))
    assert not motion.gap
    assert motion.delta.theta_rad == pytest.approx(0.29)


def test_samples_bunched_by_the_log_are_no_fast_robot() -> None:
    bunched = POSES.motion(pose(0, Pose2.identity()), pose(1_000_000, Pose2(0.15, 0.0, 0.0)))
    assert not bunched.gap


def test_stamps_must_advance_and_kinds_must_fit() -> None:
    for odometry, sample in ((DRIVE, wheels(5, 0, 0)), (POSES, pose(5, Pose2.identity()))):
        with pytest.raises(ValueError, match="not newer"):
            odometry.motion(sample, sample)
    with pytest.raises(TypeError, match="wheel samples"):
        DRIVE.motion(pose(0, Pose2.identity()), pose(1, Pose2.identity()))
    with pytest.raises(TypeError, match="integrated poses"):
        POSES.motion(wheels(0, 0.0, 0.0), wheels(1, 0.0, 0.0))
