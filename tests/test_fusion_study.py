"""The study of the fused pose on short drives: its truth is true, its rivals are fair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.recording import Trajectory
from amr_slam.studies.fusion.between import errors_m
from amr_slam.studies.fusion.methods import HELD, PRODUCT, UNDELAYED, WHEELS
from amr_slam.studies.fusion.product import estimates, localizer, twist_off
from amr_slam.studies.fusion.recordings import steady
from amr_slam.studies.fusion.simulated import (
    DRIVE,
    Scenario,
    WheelErrors,
    record,
    start_covariance,
)
from amr_slam.studies.fusion.trials import Trials, believed, joined, trials

SHORT = Scenario(name="driving", duration_s=30.0)
EXACT = WheelErrors(random_m2_per_m=0.0)


def test_wheels_that_are_exact_lead_along_the_truth() -> None:
    drive = record(SHORT, EXACT, np.random.default_rng(0))
    pose = drive.truth[0]
    for before, after in zip(drive.wheels, drive.wheels[1:], strict=False):
        pose = pose @ DRIVE.motion(before, after).delta
    # The floor scrubs the tyres: 1 % of the root of the way in heading.
    assert pose.distance_to(drive.truth[-1]) < 0.5
    assert [stamp for stamp, _ in drive.fixes] == sorted(stamp for stamp, _ in drive.fixes)
    assert all(stamp > fix.stamp_ns for stamp, fix in drive.fixes)


@pytest.mark.parametrize("seed", range(2))
def test_the_product_is_the_best_of_the_methods(seed: int) -> None:
    rng = np.random.default_rng(seed)
    far = errors_m(record(SHORT, WheelErrors(travel=0.05, yaw=-0.05), rng))
    rms = {name: float(np.sqrt(np.mean(np.square(one)))) for name, one in far.items()}
    assert rms[PRODUCT] < 0.05
    assert rms[PRODUCT] < 0.5 * min(rms[HELD], rms[UNDELAYED], rms[WHEELS])


def test_the_covariance_and_the_claim_are_true() -> None:
    """30 runs: the mean NEES of honest ones lies between 2.2 and 4.0 at 99.9 % of the steps."""
    found = trials(SHORT, 30, seed=1)
    assert 2.2 < float(found.nees.mean()) < 4.0
    assert 0.92 < found.covered < 0.99


def test_a_standing_robot_learns_no_wheels() -> None:
    still = Scenario(name="standing", duration_s=30.0, speed_mps=0.0, turn_radps=0.0)
    drive = record(still, WheelErrors(), np.random.default_rng(0))
    robot = localizer(FilterParams(), drive.truth[0], start_covariance())
    assert sum(1 for _ in estimates(drive, robot)) == len(drive.wheels)
    known = robot.calibration
    assert known is not None
    assert (known.travel, known.yaw, known.bend_radpm, known.lag_s) == (0.0, 0.0, 0.0, 0.0)
    assert known.travel_sigma == FilterParams().calibration.travel_sigma


def test_a_wrong_heading_is_the_same_twist_however_far_the_robot_drives_on() -> None:
    """In x and y the places that a wrong heading leads to lie on an arc; as twists on a line."""
    wrong = Pose2(1.0, 2.0, 0.7)
    truth = wrong @ Pose2.exp([0.0, 0.0, 0.3])
    way = Pose2(30.0, 0.0, 0.0)
    axes = Pose2(0.0, 0.0, wrong.theta_rad).adjoint()
    expected = axes @ way.inverse().adjoint() @ np.array([0.0, 0.0, 0.3])
    np.testing.assert_allclose(twist_off(wrong @ way, truth @ way), expected, atol=1e-12)


def test_runs_shared_by_processes_are_the_same_runs() -> None:
    short = Scenario(name="driving", duration_s=5.0)
    alone, shared = trials(short, 4, seed=3), trials(short, 4, seed=3, workers=2)
    np.testing.assert_array_equal(alone.whitened, shared.whitened)
    np.testing.assert_array_equal(alone.error95_m, shared.error95_m)
    assert alone.covered_sigma == shared.covered_sigma


def synthetic(rng: np.random.Generator, size: float, kept: float = 0.9) -> Trials:
    """100 runs of 200 steps whose errors are ``size`` times the claimed ones."""
    white = [rng.standard_normal((100, 3))]
    for _ in range(199):
        white.append(kept * white[-1] + np.sqrt(1.0 - kept**2) * rng.standard_normal((100, 3)))
    nothing = np.zeros((100, 200, 3))
    return Trials(
        errors=nothing,
        covariances=np.zeros((100, 200, 3, 3)),
        whitened=size * np.stack(white, axis=1),
        error95_m=nothing[..., 0],
        since_slip=np.ones((100, 200), dtype=np.int64),
        age_s=np.zeros((100, 200)),
    )


def test_an_honest_filter_reaches_the_share_that_honest_filters_reach() -> None:
    rng = np.random.default_rng(0)
    honest = [synthetic(rng, 1.0) for _ in range(20)]
    low, high = honest[0].honest(rng)
    assert 15 <= sum(low <= one.consistent <= high for one in honest) <= 20
    assert 0.85 < low < 0.94 < high < 1.0
    # Errors that are too large or too small by a tenth are found out, and what is asked stays.
    for size in (0.88, 1.12):
        other = synthetic(rng, size)
        assert other.consistent < 0.8
        assert other.honest(rng)[0] == pytest.approx(low, abs=0.05)


def test_a_mean_of_nees_is_as_sure_as_its_runs_are_many() -> None:
    """The steps of a run that hardly changes are one witness: the mean of 100 such runs varies by
    the root of 6 / 100, and 20 of them tell that."""
    rng = np.random.default_rng(2)
    found = [synthetic(rng, 1.0, kept=0.9999) for _ in range(20)]
    every = np.ones_like(found[0].is_told)
    means, sigmas = np.array([one.nees_of(every) for one in found]).T
    assert 0.6 * np.sqrt(0.06) < means.std(ddof=1) < 1.4 * np.sqrt(0.06)
    np.testing.assert_allclose(sigmas.mean(), np.sqrt(0.06), rtol=0.1)
    together = joined(found)
    np.testing.assert_allclose(together.nees_of(np.ones_like(together.is_told))[0], means.mean())


def test_only_the_chosen_steps_count_in_a_mean_of_nees() -> None:
    one = synthetic(np.random.default_rng(3), 1.0)
    young = np.zeros_like(one.is_told)
    young[:50, ::2] = True
    mean, sigma = one.nees_of(young)
    np.testing.assert_allclose(mean, one.nees[:50, ::2].mean())
    assert 0.0 < sigma < 1.0


def test_what_no_scan_can_have_told_is_parted_from_what_the_filter_should_know() -> None:
    """A slip of one run in ten, unseen for a while, spoils the mean of all, not of the others."""
    one = synthetic(np.random.default_rng(1), 1.0)
    whitened, since_slip = one.whitened.copy(), one.since_slip.copy()
    whitened[:10, 50:150] *= 10.0
    since_slip[:10, 50:150] = 0
    slipped = replace(one, whitened=whitened, since_slip=since_slip)
    assert slipped.consistent < 0.55
    assert abs(slipped.consistent_of(slipped.is_told) - one.consistent) < 0.1


def test_a_slip_is_untold_until_a_scan_of_after_it_has_come() -> None:
    slippery = Scenario(name="slip", duration_s=30.0, slips=2.0)
    drive = record(slippery, WheelErrors(), np.random.default_rng(0))
    ((begin_ns, end_ns),) = drive.slips_ns
    told_ns = min(at_ns for at_ns, fix in drive.fixes if fix.stamp_ns >= end_ns)
    assert drive.fixes_since_slip(begin_ns - 1) == len(drive.fixes)
    assert drive.fixes_since_slip(begin_ns) == drive.fixes_since_slip(told_ns - 1) == 0
    assert drive.fixes_since_slip(told_ns) == 1


def test_wheels_are_drawn_within_what_can_be_learned() -> None:
    params = FilterParams()
    rng = np.random.default_rng(0)
    drawn = [believed(params, rng) for _ in range(3000)]
    rows = np.array([(one.travel, one.yaw, one.bend_radpm, one.lag_s) for one in drawn])
    assert (np.abs(rows).max(axis=0) <= params.calibration.limits).all()
    np.testing.assert_allclose(rows.std(axis=0), params.calibration.sigmas, rtol=0.05)


def test_references_at_which_no_robot_can_have_been_are_left_out() -> None:
    """Scans that were stamped late come in bursts: a way of 0.2 m within 4 ms."""
    stamps_s = np.array([0.0, 1.0, 2.2, 2.204, 3.0])
    ways_m = np.array([0.0, 2.9, 4.0, 4.2, 6.5])
    reference = Trajectory(
        stamps_ns=(1e9 * stamps_s).astype(np.int64),
        poses=np.column_stack([ways_m, np.zeros(5), np.zeros(5)]),
    )
    np.testing.assert_array_equal(steady(reference).poses[:, 0], [0.0, 2.9, 6.5])
    np.testing.assert_array_equal(steady(reference).stamps_ns, reference.stamps_ns[[0, 1, 4]])
