from __future__ import annotations

import pytest

from amr_slam.fusion import Calibration
from amr_slam.trust import drift_of


@pytest.mark.parametrize(
    ("known", "said"),
    [
        (
            Calibration(travel=-0.018, travel_sigma=0.002),
            "the way differs by -1.8% from what they say",
        ),
        (Calibration(yaw=0.05, yaw_sigma=0.005), "turns differ by +5.0% from"),
        (Calibration(bend_radpm=0.02, bend_sigma_radpm=0.001), "bends by +1.1 deg a metre"),
        (Calibration(lag_s=0.12, lag_sigma_s=0.01), "+120 ms off the scanners"),
    ],
)
def test_wheels_that_are_not_as_configured_are_told(known: Calibration, said: str) -> None:
    advice = drift_of(known)
    assert advice is not None
    assert said in advice
    assert advice.endswith(": calibrate")


@pytest.mark.parametrize(
    "known",
    [
        Calibration(),
        Calibration(travel=0.03, travel_sigma=0.01),  # not sure yet
        Calibration(travel=0.005, travel_sigma=0.0001),  # not worth a word
        Calibration(yaw=-0.015, yaw_sigma=0.001, lag_s=0.03, lag_sigma_s=0.001),
    ],
)
def test_what_may_be_chance_or_does_not_matter_is_not(known: Calibration) -> None:
    assert drift_of(known) is None
