"""A wheel whose counts stand while the robot drives: noticed from the wheels alone."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from amr_slam.fusion import FilterParams
from amr_slam.odometry import DifferentialDrive, PoseOdometry
from amr_slam.samples import Motion, WheelSample
from amr_slam.standing_wheels import StandingWheels

DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
STEP_NS = 20_000_000
Speeds = Callable[[float], tuple[float, float]]


def driven(speeds: Speeds, until_s: float = 3.0, late_s: float = 0.0) -> list[WheelSample]:
    """50 a second; (left, right) in m/s at each instant, stamps late by ``late_s`` at most."""
    rng = np.random.default_rng(0)
    left = right = 0.0
    samples = []
    for k in range(round(until_s * 50)):
        late_ns = round(1e9 * rng.uniform(0.0, late_s))
        stamp_ns = k * STEP_NS + late_ns
        samples.append(WheelSample(stamp_ns=stamp_ns, left_rad=left, right_rad=right))
        ways = (0.02 * one for one in speeds(0.02 * k))
        left, right = (was + way / 0.1 for was, way in zip((left, right), ways, strict=True))
    return samples


def heeded(samples: list[WheelSample]) -> tuple[list[Motion], list[set[str]], list[Motion]]:
    """Motions as doubted, the suspects after each, motions as the drive tells them."""
    watch = StandingWheels(DRIVE, FilterParams())
    doubted, suspects, plain = [], [], []
    for before, after in itertools.pairwise(samples):
        motion = DRIVE.motion(before, after)
        plain.append(motion)
        doubted.append(watch.heed(after, motion))
        suspects.append(set(watch.suspects))
    return doubted, suspects, plain


@pytest.mark.parametrize("wheel", ["left", "right"])
@pytest.mark.parametrize("speed_mps", [0.4, -1.0])
def test_what_was_missed_is_in_the_covariance_from_the_first_tenth_of_a_second_on(
    wheel: str, speed_mps: float
) -> None:
    def stuck(at_s: float) -> tuple[float, float]:
        stands = 0.0 if 1.0 <= at_s < 1.8 else speed_mps
        return (stands, speed_mps) if wheel == "left" else (speed_mps, stands)

    doubted, suspects, plain = heeded(driven(stuck))
    assert not any(suspects[:52])
    assert suspects[58] == {wheel}
    assert not any(suspects[92:])
    more = sum(
        (one.covariance - was.covariance for one, was in zip(doubted, plain, strict=True)),
        np.zeros((3, 3)),
    )
    # The wheel would have gone on for 0.8 s: half of that ahead, and a turn about the other one.
    missed_m = 0.8 * abs(speed_mps)
    assert np.sqrt(more[0, 0]) == pytest.approx(0.5 * missed_m, rel=0.1)
    assert np.sqrt(more[2, 2]) == pytest.approx(missed_m / 0.5, rel=0.1)
    assert np.sign(more[0, 2]) == (-1.0 if wheel == "left" else 1.0)
    assert all(one.delta == was.delta for one, was in zip(doubted, plain, strict=True))


def doubt(doubted: list[Motion], plain: list[Motion]) -> float:
    """m: root of what the doubt adds to the variance ahead, of all motions together."""
    pairs = zip(doubted, plain, strict=True)
    return float(np.sqrt(sum(one.covariance[0, 0] - was.covariance[0, 0] for one, was in pairs)))


def test_the_first_doubt_contains_what_was_missed_until_then() -> None:
    doubted, suspects, plain = heeded(driven(lambda at_s: (0.5 if at_s < 1.0 else 0.0, 0.5)))
    first = next(k for k, one in enumerate(suspects) if one)
    missed_m = 0.5 * (0.02 * (first + 1) - 1.0)
    assert missed_m == pytest.approx(0.05, abs=0.011)
    assert doubt(doubted[: first + 1], plain[: first + 1]) == pytest.approx(0.5 * missed_m, rel=0.1)


def test_the_slower_wheel_would_have_gone_as_much_less_far() -> None:
    doubted, _, plain = heeded(driven(lambda _: (0.5, 1.0)))
    assert doubt(doubted, plain) == 0.0
    doubted, _, plain = heeded(driven(lambda at_s: (0.0 if 1.0 <= at_s < 1.8 else 0.5, 1.0)))
    assert doubt(doubted, plain) == pytest.approx(0.5 * 0.8 * 0.5, rel=0.1)


def test_scans_put_right_what_was_missed_within_two_seconds() -> None:
    """From then on the doubt grows with the way, not with its square."""
    stuck = driven(lambda at_s: (0.5 if at_s < 1.0 else 0.0, 0.5), until_s=5.0)
    doubted, _, plain = heeded(stuck)
    expected_m2 = 0.25 * (1.0**2 + 2.0 * 1.0 * 1.0)
    assert doubt(doubted, plain) == pytest.approx(np.sqrt(expected_m2), rel=0.05)


@pytest.mark.parametrize("share", [0.4, 0.6])
def test_the_other_wheel_goes_on_with_half_of_its_speed(share: float) -> None:
    _, suspects, _ = heeded(driven(lambda at_s: (0.5, 0.5) if at_s < 1.0 else (0.0, share * 0.5)))
    assert any(suspects) == (share > 0.5)


@pytest.mark.parametrize(
    "speeds",
    [
        lambda _: (0.0, 0.4),
        lambda at_s: (0.5 if at_s < 1.0 else 0.0, 0.0),
        lambda at_s: (0.5 if at_s < 1.0 else 0.0, 0.03),
        lambda at_s: (max(0.0, 0.5 - 1.5 * max(0.0, at_s - 1.0)), 0.5),
        lambda at_s: (0.5, 0.5) if at_s < 1.0 else (0.0, 0.0),
        lambda at_s: (0.1, 0.3) if at_s < 1.0 else (0.0, 0.3),
        lambda at_s: (0.22, 0.3) if at_s < 1.0 else (0.0, 0.3),
    ],
    ids=[
        "turns about a wheel",
        "stops turning about a wheel",
        "the other one crawls",
        "brakes one wheel",
        "both stand",
        "stops from a crawl",
        "turns, which helps to stop",
    ],
)
@pytest.mark.parametrize("late_s", [0.0, 0.01])
def test_what_a_robot_can_do_is_not_doubted(speeds: Speeds, late_s: float) -> None:
    doubted, suspects, plain = heeded(driven(speeds, late_s=late_s))
    assert not any(suspects)
    assert all(one is was for one, was in zip(doubted, plain, strict=True))


def test_a_robot_that_halts_with_a_dead_counter_is_not_lost_by_standing() -> None:
    def halts(at_s: float) -> tuple[float, float]:
        right = 0.5 if at_s < 1.6 else 0.0
        return (0.5 if at_s < 1.0 else 0.0), right

    doubted, suspects, plain = heeded(driven(halts, until_s=5.0))
    assert suspects[-1] == {"left"}
    for one, was in zip(doubted[85:], plain[85:], strict=True):
        np.testing.assert_array_equal(one.covariance, was.covariance)


def test_a_gap_or_a_new_segment_ends_the_suspicion() -> None:
    samples = driven(lambda at_s: (0.5 if at_s < 1.0 else 0.0, 0.5))
    watch = StandingWheels(DRIVE, FilterParams())
    for before, after in itertools.pairwise(samples[:100]):
        watch.heed(after, DRIVE.motion(before, after))
    assert set(watch.suspects) == {"left"}
    other = replace(samples[100], segment=1)
    motion = DRIVE.motion(samples[99], other)
    assert motion.gap
    assert watch.heed(other, motion) is motion
    assert not watch.suspects


@pytest.mark.parametrize("is_gap", [False, True])
def test_either_of_the_two_is_enough(is_gap: bool) -> None:
    samples = driven(lambda at_s: (0.5 if at_s < 1.0 else 0.0, 0.5))
    watch = StandingWheels(DRIVE, FilterParams())
    for before, after in itertools.pairwise(samples[:100]):
        watch.heed(after, DRIVE.motion(before, after))
    newest, motion = samples[100], DRIVE.motion(samples[99], samples[100])
    if is_gap:
        motion = DRIVE.silence(samples[99].stamp_ns, newest.stamp_ns)
    else:
        newest = replace(newest, segment=1)
    assert watch.heed(newest, motion) is motion
    assert not watch.suspects


def test_other_drives_and_wheels_read_seldom_are_let_pass() -> None:
    samples = driven(lambda at_s: (1.0 if at_s < 1.0 else 0.0, 1.0))
    motions = [DRIVE.motion(*pair) for pair in itertools.pairwise(samples)]
    poses = StandingWheels(PoseOdometry(), FilterParams())
    assert all(poses.heed(samples[k + 1], one) is one for k, one in enumerate(motions))
    seldom = samples[::5]
    watch = StandingWheels(DRIVE, FilterParams())
    for before, after in itertools.pairwise(seldom):
        motion = DRIVE.motion(before, after)
        assert watch.heed(after, motion) is motion
