"""Scrapes over HTTP of what a loop leaves lying, and of a daemon."""

from __future__ import annotations

import logging
import socket
import urllib.request
from pathlib import Path

import pytest
from daemon_rig import Daemon, Robot, until
from messages import pose_of, status_of
from prometheus_client.parser import text_string_to_metric_families

from amr_slam.config import MetricsSettings
from amr_slam.samples import State
from amr_slam.service.metrics import Metrics, MetricsServer

Figures = dict[tuple[str, tuple[str, ...]], float]


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def scraped(port: int) -> Figures:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30.0) as answer:
        text = answer.read().decode()
    return {
        (sample.name, tuple(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_figures_are_those_of_the_newest_messages() -> None:
    metrics, port = Metrics(), free_port()
    server = MetricsServer(MetricsSettings(port=port), metrics)
    try:
        assert scraped(port)["amr_pose_period_seconds_count", ()] == 0.0
        pose, status = pose_of(), status_of()
        for tick in range(101):
            metrics.note_pose(pose, 20_000_000 * tick)
        metrics.note_pose(pose, 20_000_000 * 100 + 300_000_000)
        metrics.note_status(status)
        figures = scraped(port)
    finally:
        server.close()
        server.close()
    assert figures["amr_pose_period_seconds_bucket", ("0.022",)] == 100.0
    assert figures["amr_pose_period_seconds_bucket", ("0.25",)] == 100.0
    assert figures["amr_pose_period_seconds_bucket", ("+Inf",)] == 101.0
    assert figures["amr_pose_period_seconds_sum", ()] == pytest.approx(2.3)
    assert figures["amr_pose_error95_meters", ()] == pose.error95_m
    assert sum(figures["amr_state", (str(state),)] for state in State) == 1.0
    assert figures["amr_state", (str(pose.state),)] == 1.0
    for name, part in status.health().items():
        assert figures["amr_device_samples_total", (name,)] == part.samples
        assert figures["amr_device_up", (name,)] == float(part.link == "OK")
    assert figures["amr_memory_bytes", ()] == 1e6 * status.memory_mb


def test_a_port_that_is_taken_stops_no_robot(caplog: pytest.LogCaptureFixture) -> None:
    with socket.socket() as taken, caplog.at_level(logging.ERROR):
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = int(taken.getsockname()[1])
        MetricsServer(MetricsSettings(port=port), Metrics()).close()
    assert f"metrics: 127.0.0.1:{port}" in caplog.text


def test_a_scraper_that_never_reads_holds_no_pose_up(tmp_path: Path) -> None:
    port = free_port()
    with Robot(tmp_path), Daemon(tmp_path, settings=f"[metrics]\nport = {port}\n") as daemon:
        daemon.listen()
        daemon.status_when(lambda s: s.state is State.MAPPING, "mapping")
        with socket.create_connection(("127.0.0.1", port)) as mute:
            mute.sendall(b"GET /metrics HTTP/1.1\r\n")
            before = daemon.next_poses(1)[0].seq
            assert daemon.next_poses(50)[-1].seq > before + 49
            until(lambda: scraped(port)["amr_state", ("mapping",)] == 1.0, "mapping")
            figures = scraped(port)
        assert figures["amr_pose_period_seconds_count", ()] > 50.0
        assert figures["amr_device_samples_total", ("wheels",)] > 50.0
        assert daemon.stop() == 0
