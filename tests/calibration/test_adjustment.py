"""The adjustment alone: sightings are drawn, not registered, so that their noise is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from amr_slam.calibration import Calibration, Measures, ScannerMeasures, Sightings, adjust
from amr_slam.calibration.report import config_lines, describe, drifted
from amr_slam.calibration.wheels import WheelTrack
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.samples import WheelSample

TRUTH = Measures(
    radius_left_m=0.103,
    radius_right_m=0.098,
    track_m=0.52,
    scanners=(
        ScannerMeasures(name="front", base_from_lidar=Pose2(0.25, 0.18, 0.8), lag_s=0.08),
        ScannerMeasures(name="rear", base_from_lidar=Pose2(-0.2, -0.22, 3.12), lag_s=0.02),
    ),
)
GIVEN = Measures(
    radius_left_m=0.1,
    radius_right_m=0.1,
    track_m=0.5,
    scanners=(
        ScannerMeasures(name="front", base_from_lidar=Pose2(0.22, 0.2, 0.76)),
        ScannerMeasures(name="rear", base_from_lidar=Pose2(-0.24, -0.2, -3.13)),
    ),
)
PERIOD_S = 0.02
SIGMA = np.array([0.003, 0.003, math.radians(0.1)])
SLIP_M = 0.001


def driven(
    seed: int, duration_s: float = 90.0, *, straight: bool = False, inflate: float = 1.0
) -> tuple[Sightings, WheelTrack]:
    """A smooth drive that speeds, brakes and turns both ways; a scan of each scanner in 0.5 s."""
    rng = np.random.default_rng(seed)
    steps = round(duration_s / PERIOD_S)
    times_s = PERIOD_S * np.arange(steps + 1)
    v = 0.4 + 0.3 * np.sin(0.7 * times_s)
    omega = np.zeros(steps + 1) if straight else 0.8 * np.sin(0.4 * times_s) * (v > 0.2)
    way = PERIOD_S * np.column_stack(
        [v - 0.5 * TRUTH.track_m * omega, v + 0.5 * TRUTH.track_m * omega]
    )
    angles = np.cumsum(way / [TRUTH.radius_left_m, TRUTH.radius_right_m], axis=0)
    floor = way + SLIP_M * np.sqrt(np.abs(way)) * rng.normal(size=way.shape)
    pose, path = Pose2.identity(), []
    for left, right in floor:
        path.append(pose.as_array())
        pose = pose @ Pose2.exp([0.5 * (left + right), 0.0, (right - left) / TRUTH.track_m])
    poses = np.array(path)
    poses[:, 2] = np.unwrap(poses[:, 2])
    wheels = WheelTrack(
        [
            WheelSample(stamp_ns=round(1e9 * t), left_rad=float(a), right_rad=float(b))
            # An angle stands for the instant before the step that it adds.
            for t, (a, b) in zip(times_s[1:], angles[:-1], strict=True)
        ]
    )
    found: list[tuple[int, float, Array]] = []
    for number, scanner in enumerate(TRUTH.scanners):
        for instant_s in np.arange(1.0 + 0.21 * number, duration_s - 1.0, 0.5):
            base = [np.interp(instant_s, times_s, column) for column in poses.T]
            lidar = (Pose2.from_array(base) @ scanner.base_from_lidar).as_array()
            found.append((number, instant_s + scanner.lag_s, lidar + SIGMA * rng.normal(size=3)))
    return Sightings(
        scanner=np.array([row[0] for row in found]),
        stamps_ns=np.array([round(1e9 * row[1]) for row in found]),
        poses=np.array([row[2] for row in found]),
        covariances=np.tile(np.diag((inflate * SIGMA) ** 2), (len(found), 1, 1)),
    ), wheels


def error_of(found: Calibration) -> Array:
    error = found.measures.as_array() - TRUTH.as_array()
    error[5::4] = wrap_angle(error[5::4])
    return error


def test_measures_are_found_and_their_uncertainty_is_true() -> None:
    squared = []
    for seed in range(12):
        # That sightings claim three times their noise must not matter: its level is found, too.
        found = adjust(GIVEN, GIVEN, *driven(seed, inflate=3.0))
        error = error_of(found)
        assert np.abs(error / found.sigmas).max() < 5.0
        squared.append(error @ np.linalg.solve(found.covariance, error))
        assert found.doubts() == ()
    # The mean of chi2 with 11 degrees over 12 drives is within 11 +- 4.1 in 99.8 %.
    assert 6.9 < np.mean(squared) < 15.1


def test_one_wrong_sighting_in_twenty_does_not_spoil_it() -> None:
    sightings, wheels = driven(3)
    poses = np.array(sightings.poses)
    poses[::20] += [0.5, -0.3, 0.2]
    spoilt = Sightings(
        scanner=sightings.scanner,
        stamps_ns=sightings.stamps_ns,
        poses=poses,
        covariances=sightings.covariances,
    )
    error = np.abs(error_of(adjust(GIVEN, GIVEN, spoilt, wheels)))
    assert np.all(error[:3] < 0.003 * TRUTH.as_array()[:3])
    assert np.all(error[[3, 4, 7, 8]] < 0.005)


def test_a_drive_that_does_not_turn_says_what_it_cannot_tell() -> None:
    found = adjust(GIVEN, GIVEN, *driven(1, straight=True))
    doubts = " ".join(found.doubts())
    assert "track: turn more" in doubts
    assert "front: place" in doubts
    assert "front: angle" not in doubts
    lines = "\n".join(config_lines(found))
    assert "track_m = 0.500000" in lines  # as configured: nothing better is known
    assert "x_m = 0.2200" in lines
    assert any("does not tell" in line for line in describe(found))


def test_drift_is_told_where_it_is_more_than_chance() -> None:
    drive = driven(5)
    said = " ".join(drifted(adjust(GIVEN, GIVEN, *drive)))
    assert "left radius: configured 100 mm, the drive says 103" in said
    assert "front clock lag" in said
    assert "rear angle" in said
    assert drifted(adjust(TRUTH, TRUTH, *drive)) == ()


@pytest.mark.parametrize("scanner", [0, 1])
def test_one_scanner_is_enough(scanner: int) -> None:
    sightings, wheels = driven(4)
    own = sightings.scanner == scanner
    given = Measures(
        radius_left_m=0.1, radius_right_m=0.1, track_m=0.5, scanners=(GIVEN.scanners[scanner],)
    )
    found = adjust(
        given,
        given,
        Sightings(
            scanner=np.zeros(int(own.sum()), dtype=np.int64),
            stamps_ns=sightings.stamps_ns[own],
            poses=sightings.poses[own],
            covariances=sightings.covariances[own],
        ),
        wheels,
    )
    assert found.measures.track_m == pytest.approx(TRUTH.track_m, rel=0.003)
    assert found.measures.scanners[0].base_from_lidar.distance_to(
        TRUTH.scanners[scanner].base_from_lidar
    ) < 0.005  # fmt: skip
