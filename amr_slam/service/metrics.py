"""Figures for Prometheus, where somebody wants them: off unless configured.

A scrape reads what the loop has left lying; the loop never waits for one. The only file that
imports prometheus_client.
"""

from __future__ import annotations

import bisect
import logging
from collections.abc import Iterator, Mapping
from typing import Final

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from amr_slam.config import MetricsSettings
from amr_slam.states import State
from amr_slam.wire import HealthPart, PoseMessage, StatusMessage

_log = logging.getLogger(__name__)

_BOUNDS_S: Final = (0.005, 0.01, 0.015, 0.02, 0.022, 0.025, 0.03, 0.04, 0.06, 0.1, 0.25, 1.0)


class Metrics(Collector):
    """One daemon's figures. What the loop calls returns at once."""

    def __init__(self) -> None:
        self._pose: PoseMessage | None = None
        self._pose_ns: int | None = None
        self._status: StatusMessage | None = None
        self._periods = [0] * (len(_BOUNDS_S) + 1)
        self._total_s = 0.0

    def note_pose(self, message: PoseMessage, now_ns: int) -> None:
        """A pose leaves."""
        if self._pose_ns is not None:
            period_s = 1e-9 * (now_ns - self._pose_ns)
            self._periods[bisect.bisect_left(_BOUNDS_S, period_s)] += 1
            self._total_s += period_s
        self._pose, self._pose_ns = message, now_ns

    def note_status(self, message: StatusMessage) -> None:
        """A status leaves."""
        self._status = message

    def collect(self) -> Iterator[Metric]:
        """On the scraper's thread."""
        pose, status = self._pose, self._status
        if pose is not None:
            yield from _of_pose(pose)
        yield self._histogram()
        if status is not None:
            yield from _of_status(status)

    def _histogram(self) -> Metric:
        found, below = HistogramMetricFamily("amr_pose_period_seconds", "Between two poses"), 0
        buckets = []
        for bound_s, count in zip((*map(str, _BOUNDS_S), "+Inf"), list(self._periods), strict=True):
            below += count
            buckets.append((bound_s, float(below)))
        found.add_metric([], buckets, self._total_s)
        return found


class MetricsServer:
    """Answers scrapes on threads of its own."""

    def __init__(self, settings: MetricsSettings, metrics: Metrics) -> None:
        """Where nothing can be listened on, a line says so: no robot stops for its figures."""
        registry = CollectorRegistry(auto_describe=False)
        registry.register(metrics)
        self._running = None
        try:
            self._running = start_http_server(settings.port, settings.host, registry)
        except OSError as error:
            where = f"{settings.host}:{settings.port}"
            _log.error("metrics: %s: %s", where, error.strerror or error)

    def close(self) -> None:
        """Idempotent."""
        if self._running is not None:
            (server, thread), self._running = self._running, None
            server.shutdown()
            server.server_close()
            thread.join()


def _gauge(name: str, text: str, value: float | None, **labels: str) -> Metric:
    found = GaugeMetricFamily(f"amr_{name}", text, labels=list(labels))
    if value is not None:
        found.add_metric(list(labels.values()), value)
    return found


def _of_pose(pose: PoseMessage) -> Iterator[Metric]:
    yield _gauge("pose_stamp_seconds", "UTC of the newest pose", pose.stamp)
    yield _gauge("pose_wheel_age_seconds", "Age of the wheel sample in it", pose.age_s)
    yield _gauge("pose_error95_meters", "Error that 95 % do not exceed", pose.error95_m)
    yield _gauge("pose_since_fix_seconds", "Since the last fix in it", pose.since_fix_s)
    yield _gauge("pose_epoch", "Jumps so far", pose.epoch)
    states = GaugeMetricFamily("amr_state", "1 for the present one", labels=["state"])
    for state in State:
        states.add_metric([str(state)], float(state is pose.state))
    yield states


def _of_status(status: StatusMessage) -> Iterator[Metric]:
    yield from _of_devices(status.health())
    outcomes = CounterMetricFamily("amr_outcomes", "Samples by what became", labels=["outcome"])
    for name, count in status.outcomes.items():
        outcomes.add_metric([name], count)
    yield outcomes
    yield _gauge("cpu_percent", "Of one core, all processes", status.cpu_percent)
    yield _gauge("memory_bytes", "Resident, all processes", 1e6 * status.memory_mb)
    yield _gauge("uptime_seconds", "Since the start", status.uptime_s)
    yield _gauge("map_scans", "In the active map", status.map.version if status.map else None)
    yield _gauge("clock_steps", "Times that UTC was set", status.clock_steps)
    yield _gauge("fault", "1 while something is wrong", float(status.fault is not None))


def _of_devices(parts: Mapping[str, HealthPart]) -> Iterator[Metric]:
    by_device = ["device"]
    up = GaugeMetricFamily("amr_device_up", "1 while its link is OK", labels=by_device)
    age = GaugeMetricFamily("amr_device_age_seconds", "Of its newest sample", labels=by_device)
    rate = GaugeMetricFamily("amr_device_rate_hertz", "Samples a second", labels=by_device)
    samples = CounterMetricFamily("amr_device_samples", "So far", labels=by_device)
    errors = CounterMetricFamily("amr_device_errors", "So far", labels=by_device)
    for name, part in parts.items():
        up.add_metric([name], float(part.link == "OK"))
        if part.age_s is not None:
            age.add_metric([name], part.age_s)
        rate.add_metric([name], part.rate_hz)
        samples.add_metric([name], part.samples)
        errors.add_metric([name], part.errors)
    yield from (up, age, rate, samples, errors)
