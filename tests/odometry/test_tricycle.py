from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.fusion.trail import Trail
from amr_slam.geometry import Pose2
from amr_slam.odometry import DifferentialDrive, TricycleDrive
from amr_slam.samples import JointSample, Motion, WheelSample

DRIVE = TricycleDrive(radius_m=0.12, wheel_base_m=1.4, wheel_y_m=0.1, steer_offset_rad=0.02)
STEP_NS = 20_000_000
rolled_m = st.floats(-0.04, 0.04)
steer_rad = st.floats(-1.5, 1.5)
change_rad = st.floats(-0.05, 0.05)


def sample(stamp_ns: int, rolled_m: float, steer_rad: float, segment: int = 0) -> JointSample:
    """``steer_rad`` is the true one; the driver's has the offset on it."""
    return JointSample(
        stamp_ns=stamp_ns,
        names=("drive", "steer"),
        angles_rad=(rolled_m / 0.12, steer_rad + 0.02),
        segment=segment,
    )


def step(rolled: float, steer: float, change: float, pieces: int = 1) -> Motion:
    """Rolling and steering evenly within 20 ms, read in ``pieces`` and composed again."""
    trail = Trail(0)
    samples = [
        sample(STEP_NS * i // pieces, rolled * i / pieces, steer + change * i / pieces)
        for i in range(pieces + 1)
    ]
    for previous, current in pairwise(samples):
        trail.append(DRIVE.motion(previous, current))
    return trail.between(0, STEP_NS)


def integrated(rolled: float, steer: float, change: float, drive: TricycleDrive = DRIVE) -> Pose2:
    """The wheel's own way in 2000 straight bits, by the no-slip condition of the fixed axle:
    the contact point goes along the wheel, the axle's middle along the robot."""
    x = y = theta = 0.0
    bits = 2000
    for i in range(bits):
        delta = steer + change * (i + 0.5) / bits
        ds = rolled / bits
        omega = ds * math.sin(delta) / drive.wheel_base_m
        v = ds * math.cos(delta) + omega * drive.wheel_y_m
        middle = theta + 0.5 * omega
        x, y, theta = x + v * math.cos(middle), y + v * math.sin(middle), theta + omega
    return Pose2(x, y, theta)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(rolled=rolled_m, steer=steer_rad, change=change_rad)
def test_a_step_is_that_of_exact_integration(rolled: float, steer: float, change: float) -> None:
    motion = step(rolled, steer, change)
    exact = integrated(rolled, steer, change)
    assert not motion.gap
    assert motion.delta.theta_rad == pytest.approx(exact.theta_rad, abs=1e-9)
    # The mean twist's arc: of second order in a turn of 1/40 rad and a steering of 1/20 rad.
    assert motion.delta.x_m == pytest.approx(exact.x_m, abs=1e-7)
    assert motion.delta.y_m == pytest.approx(exact.y_m, abs=1e-5)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(rolled=rolled_m, steer=steer_rad, change=st.floats(-0.002, 0.002), pieces=st.integers(2, 20))
def test_a_step_cut_into_pieces_has_the_same_covariance(
    rolled: float, steer: float, change: float, pieces: int
) -> None:
    whole, cut = step(rolled, steer, change), step(rolled, steer, change, pieces)
    np.testing.assert_allclose(cut.delta.as_array(), whole.delta.as_array(), atol=1e-6)
    scale = np.abs(whole.covariance).max()
    np.testing.assert_allclose(cut.covariance, whole.covariance, rtol=0.02, atol=0.005 * scale)
    assert np.linalg.eigvalsh(whole.covariance)[0] >= -1e-15


def test_the_wheel_rolls_along_its_own_direction_about_one_centre() -> None:
    """A full circle: the fixed axle's middle returns, its radius is wheel base over tan."""
    steer, trail = 0.6, Trail(0)
    radius = DRIVE.wheel_base_m / math.tan(steer)
    wheel_radius = math.hypot(DRIVE.wheel_base_m, radius - DRIVE.wheel_y_m)
    # The wheel itself is nearer to the centre by its place left of the middle.
    steer_wheel = math.atan2(DRIVE.wheel_base_m, radius - DRIVE.wheel_y_m)
    round_m, pieces = 2 * math.pi * wheel_radius, 1000
    for i in range(pieces):
        trail.append(
            DRIVE.motion(
                sample(i * STEP_NS, round_m * i / pieces, steer_wheel),
                sample((i + 1) * STEP_NS, round_m * (i + 1) / pieces, steer_wheel),
            )
        )
    half = trail.between(0, pieces // 2 * STEP_NS)
    assert half.delta.y_m == pytest.approx(2 * radius, abs=1e-6)
    whole = trail.between(0, pieces * STEP_NS)
    np.testing.assert_allclose(whole.delta.as_array(), [0.0, 0.0, 0.0], atol=1e-6)


def test_straight_ahead_equals_a_differential_drive() -> None:
    wheels = DifferentialDrive(radius_left_m=0.12, radius_right_m=0.12, track_m=1.0)
    turned = 0.03 / 0.12
    two = wheels.motion(
        WheelSample(stamp_ns=0, left_rad=0.0, right_rad=0.0),
        WheelSample(stamp_ns=STEP_NS, left_rad=turned, right_rad=turned),
    )
    one = step(0.03, 0.0, 0.0)
    np.testing.assert_allclose(one.delta.as_array(), two.delta.as_array(), atol=1e-15)


def test_steered_by_a_right_angle_it_turns_on_the_spot() -> None:
    drive = TricycleDrive(radius_m=0.12, wheel_base_m=1.4)
    motion = drive.motion(
        JointSample(stamp_ns=0, names=drive.joints, angles_rad=(0.0, math.pi / 2)),
        JointSample(stamp_ns=STEP_NS, names=drive.joints, angles_rad=(0.5, math.pi / 2)),
    )
    np.testing.assert_allclose(motion.delta.as_array(), [0.0, 0.0, 0.06 / 1.4], atol=1e-15)


def test_a_wheel_behind_the_axle_turns_the_other_way() -> None:
    behind = TricycleDrive(radius_m=0.12, wheel_base_m=-1.4)
    ahead = TricycleDrive(radius_m=0.12, wheel_base_m=1.4)
    samples = [
        JointSample(stamp_ns=i * STEP_NS, names=behind.joints, angles_rad=(0.2 * i, 0.3))
        for i in range(2)
    ]
    turns = [drive.motion(*samples).delta.theta_rad for drive in (behind, ahead)]
    assert turns[0] == -turns[1] < 0.0


def test_standing_adds_nothing_even_while_steering() -> None:
    motion = step(0.0, -1.0, 2.0)
    assert motion.delta == Pose2.identity()
    assert not motion.covariance.any()


def test_the_noise_of_wheel_and_steering_is_that_of_the_covariance() -> None:
    """Monte Carlo of the law itself: both are off by white noise along the way."""
    rng = np.random.default_rng(2)
    drive = TricycleDrive(
        radius_m=0.12, wheel_base_m=1.4, wheel_y_m=0.3, yaw_rad2_per_m=0.0, steer_rad2_m=1e-3
    )
    pieces, rolled, steer = 20, 0.04, 0.7
    said = drive.motion(
        JointSample(stamp_ns=0, names=drive.joints, angles_rad=(0.0, steer)),
        JointSample(stamp_ns=STEP_NS, names=drive.joints, angles_rad=(rolled / 0.12, steer)),
    )
    errors = []
    part = rolled / pieces
    for _ in range(2000):
        end = Pose2.identity()
        for _ in range(pieces):
            ds = part + rng.normal(0.0, math.sqrt(drive.wheel_m2_per_m * part))
            # First order: an angle whose white noise has this density over the way.
            side = rng.normal(0.0, math.sqrt(drive.steer_rad2_m * part))
            omega = (ds * math.sin(steer) + side * math.cos(steer)) / drive.wheel_base_m
            v = ds * math.cos(steer) - side * math.sin(steer) + omega * drive.wheel_y_m
            end = end @ Pose2.exp([v, 0.0, omega])
        errors.append((said.delta.inverse() @ end).as_array())
    seen = np.cov(np.array(errors).T)
    sigma = np.sqrt(np.diag(said.covariance))
    assert np.abs((seen - said.covariance) / np.outer(sigma, sigma)).max() < 0.12


@pytest.mark.parametrize(
    "current",
    [
        sample(STEP_NS, 0.01, 0.0, segment=1),
        sample(STEP_NS, 1.0, 0.0),
        sample(STEP_NS, 0.2, 1.5),
        sample(STEP_NS, math.nan, 0.0),
        sample(STEP_NS, 0.0, math.nan),
        sample(STEP_NS, math.inf, 0.0),
        sample(STEP_NS, 0.0, math.inf),
    ],
    ids=["segment", "too fast", "turns too fast", "nan", "nan angle", "inf", "inf angle"],
)
def test_what_wheels_cannot_tell_is_a_gap(current: JointSample) -> None:
    motion = DRIVE.motion(sample(0, 0.0, 1.5), current)
    assert motion.gap
    np.testing.assert_array_equal(motion.covariance, DRIVE.silence(0, STEP_NS).covariance)


def test_kinds_must_fit() -> None:
    wheels = WheelSample(stamp_ns=1, left_rad=0.0, right_rad=0.0)
    with pytest.raises(TypeError, match="drive and steer"):
        DRIVE.motion(sample(0, 0.0, 0.0), wheels)
    with pytest.raises(ValueError, match="not newer"):
        DRIVE.motion(sample(0, 0.0, 0.0), sample(0, 0.0, 0.0))
    with pytest.raises(ValueError, match="no drive steers"):
        TricycleDrive(radius_m=0.1, wheel_base_m=0.0)
    with pytest.raises(ValueError, match="1 angles for 2 joints"):
        JointSample(stamp_ns=0, names=("drive", "steer"), angles_rad=(0.0,))
