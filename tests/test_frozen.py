from __future__ import annotations

import numpy as np

from amr_slam.frozen import FrozenScans
from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Motion, Scan

PERIOD_NS = 2_000_000_000


class Line:
    """One scanner's scans, one every 2 s, while the wheels make a step between any two."""

    def __init__(self, step_m: float) -> None:
        self.frozen, self.step_m, self.stamp_ns = FrozenScans(), step_m, 0

    def takes(self, ranges_m: Array) -> bool:
        self.stamp_ns += PERIOD_NS
        scan = Scan(
            scanner="rear",
            stamp_ns=self.stamp_ns,
            ranges_m=ranges_m,
            angle_min_rad=0.0,
            angle_step_rad=0.01,
        )
        return not self.frozen.repeats(scan, self.motion)

    def motion(self, start_ns: int, end_ns: int) -> Motion:
        return Motion(
            start_ns=start_ns,
            end_ns=end_ns,
            delta=Pose2(self.step_m, 0.0, 0.0),
            covariance=np.eye(3),
        )


def noisy(seed: int) -> Array:
    return 3.0 + np.random.default_rng(seed).normal(0.0, 0.01, 200)


def test_the_third_identical_scan_on_the_way_is_frozen_and_the_next_new_one_is_not() -> None:
    line = Line(0.5)
    assert [line.takes(noisy(1)) for _ in range(2)] == [True, False]
    assert not line.frozen.names
    assert not line.takes(noisy(1))
    assert line.frozen.names == {"rear"}
    assert line.takes(noisy(2))
    assert not line.frozen.names


def test_a_scanner_that_has_shown_noise_is_frozen_while_the_robot_stands_too() -> None:
    line = Line(0.0)
    assert line.takes(noisy(1))
    assert [line.takes(noisy(2)) for _ in range(3)] == [True, False, False]
    assert line.frozen.names == {"rear"}


def test_without_noise_a_standing_robot_sees_the_same_and_may() -> None:
    line = Line(0.0)
    assert all(line.takes(np.full(200, 3.0)) for _ in range(10))
    # Somebody passes: a few beams change, which is no noise.
    passed = np.full(200, 3.0)
    passed[:15] = 1.0
    assert all(line.takes(passed) for _ in range(10))


def test_an_empty_yard_repeats_itself_and_is_no_fault() -> None:
    line = Line(0.5)
    empty = np.full(200, np.inf)
    empty[:10] = np.nan
    assert all(line.takes(empty) for _ in range(10))


def test_readings_without_a_measurement_are_compared_too() -> None:
    line = Line(0.5)
    ranges = noisy(1)
    ranges[5] = np.nan
    assert [line.takes(ranges) for _ in range(3)] == [True, False, False]
    other = np.array(ranges)
    other[6] = np.nan
    assert line.takes(other)
