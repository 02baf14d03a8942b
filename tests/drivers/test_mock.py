from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest

from amr_drivers.errors import LinkLost
from amr_drivers.mock import odometry, scanner
from amr_drivers.mock.stage import STAGES
from amr_slam.samples import OdometrySource, Scanner

DEADLINE_S = 20.0


def test_wheels_and_scans_of_one_robot_come_in_real_time() -> None:
    wheels = odometry.open_odometry(odometry.Settings(seed=3))
    front = scanner.open_scanner("front", scanner.Settings(seed=3, period_s=0.1))
    assert STAGES._held[3][1] == 2
    stamps_ns = []
    for _ in range(10):
        sample = wheels.read(DEADLINE_S)
        assert sample is not None
        assert sample.stamp_ns <= time.monotonic_ns()
        stamps_ns.append(sample.stamp_ns)
    assert set(np.diff(stamps_ns)) == {20_000_000}
    first = front.read(DEADLINE_S)
    second = front.read(DEADLINE_S)
    assert first is not None
    assert second is not None
    assert first.scanner == "front"
    assert second.stamp_ns + round(1e9 * second.sweep_s) <= time.monotonic_ns()
    assert (second.stamp_ns - first.stamp_ns) % 100_000_000 == 0
    seen = np.isfinite(second.ranges_m)
    assert seen.mean() > 0.9
    assert front.read(0.0) is None
    wheels.close()
    front.close()
    assert not STAGES._held


def test_the_robot_moves_on() -> None:
    wheels = odometry.open_odometry(odometry.Settings(seed=3))
    stage = wheels._hold.value
    sample = stage.wheels_after(stage.start_ns + 3_000_000_000)  # ahead of time
    assert sample.left_rad > math.pi
    assert sample.right_rad > math.pi
    wheels.close()


@pytest.mark.parametrize("kind", ["wheels", "scanner"])
def test_close_ends_a_waiting_read(kind: str) -> None:
    device: Scanner | OdometrySource
    if kind == "wheels":
        device = odometry.open_odometry(odometry.Settings(seed=4))
    else:
        device = scanner.open_scanner("front", scanner.Settings(seed=4, period_s=10.0))
    ended: list[LinkLost] = []

    def wait() -> None:
        try:
            while True:
                device.read(60.0)
        except LinkLost as error:
            ended.append(error)

    reader = threading.Thread(target=wait)
    reader.start()
    device.close()
    device.close()
    reader.join(DEADLINE_S)
    assert len(ended) == 1
    assert not STAGES._held
