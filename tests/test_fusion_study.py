"""The study of the fused pose on short drives: its truth is true, its rivals are fair."""

from __future__ import annotations

import numpy as np
import pytest

from amr_slam.fusion import FilterParams
from amr_slam.studies.fusion.between import errors_m
from amr_slam.studies.fusion.methods import HELD, PRODUCT, UNDELAYED, WHEELS
from amr_slam.studies.fusion.product import estimates, localizer
from amr_slam.studies.fusion.simulated import (
    DRIVE,
    Scenario,
    WheelErrors,
    record,
    start_covariance,
)
from amr_slam.studies.fusion.trials import trials

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
