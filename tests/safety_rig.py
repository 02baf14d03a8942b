"""An emulated safety scanner that sweeps by itself, and what tests wait for."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np

from amr_drivers.emulators.safety import EmulatedSafety, SafetyModel
from amr_drivers.sick_safety.driver import Polled, Settings, Streamed, open_scanner
from amr_slam.geometry import Array
from amr_slam.samples import Scan, Tap, untapped

DEADLINE_S = 20.0


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


class Sweeping:
    """Sweeps in the model's period; remembers when each began and what it saw."""

    def __init__(self, device: EmulatedSafety) -> None:
        self.device = device
        self.truth_ns: dict[float, int] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._sweep)

    def ranges(self, number: int) -> Array:
        """Differ from sweep to sweep, so that a scan tells which it is."""
        ranges = np.linspace(1.0, 20.0, self.device.model.derived.beams)
        ranges[0] = 0.1 + 0.001 * (number % 30_000)
        ranges[5], ranges[6] = np.inf, np.nan
        return ranges

    def truth(self, scan: Scan) -> int:
        return self.truth_ns[round(float(scan.ranges_m[0]), 3)]

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _sweep(self) -> None:
        period_s, number = self.device.model.period_s, 0
        begun_s = time.monotonic()
        while not self._stop.wait(max(0.0, begun_s + number * period_s - time.monotonic())):
            ranges = self.ranges(number)
            key = round(float(ranges[0]), 3)
            self.truth_ns[key] = time.monotonic_ns()
            self.truth_ns[key] = self.device.measure(ranges)
            number += 1


def settings_for(device: EmulatedSafety, **changes: object) -> Settings:
    values: dict[str, object] = {
        "host": "127.0.0.1",
        "port": device.port,
        "poll_interval_s": 0.1,
        "latency_limit_s": 1.0,
        "silence_s": 2.0,
    }
    return Settings(**(values | changes))  # type: ignore[arg-type] # any field


def opened(device: EmulatedSafety, tap: Tap = untapped, **changes: object) -> Polled | Streamed:
    return open_scanner("front", settings_for(device, **changes), tap)


def next_scan(driver: Polled | Streamed) -> Scan:
    scan: Scan | None = None
    deadline = time.monotonic() + DEADLINE_S
    while scan is None:
        assert time.monotonic() < deadline, driver.status()
        scan = driver.read(0.5)
    return scan


__all__ = ["SafetyModel", "Sweeping", "next_scan", "opened", "settings_for", "until"]
