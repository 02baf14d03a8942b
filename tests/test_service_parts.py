from __future__ import annotations

import logging
import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import REPO

from amr_drivers import registry
from amr_drivers.errors import LinkLost
from amr_drivers.mock.scanner import Settings as MockSettings
from amr_slam.config import MountingSettings, OdometrySettings, ScannerSettings
from amr_slam.samples import DeviceInfo, DriveSample, Link, Scan, WheelSample
from amr_slam.service.clocks import PoseSchedule, WallClock
from amr_slam.service.devices import DeviceEnded, ScannerThread, Thinning, WheelsThread
from amr_slam.service.usage import Usage

S = 1_000_000_000
MS = 1_000_000
DEADLINE_S = 10.0


# -- thinning ------------------------------------------------------------------------------


def taken(thinning: Thinning, stamps_ns: list[int]) -> list[int]:
    return [stamp for stamp in stamps_ns if thinning.takes(stamp)]


def test_two_fast_scanners_are_taken_at_the_same_time() -> None:
    front = taken(Thinning(2.0), [7 * MS + 40 * MS * n for n in range(500)])
    rear = taken(Thinning(2.0), [900 * MS + 33 * MS * n for n in range(500)])
    for stamp in front[1:8]:
        assert min(abs(stamp - other) for other in rear) <= 40 * MS
    gaps = np.diff(front[1:])
    assert np.all(np.abs(gaps - 2 * S) <= 80 * MS)


@settings(derandomize=True, deadline=None)
@given(
    interval_ms=st.integers(20, 400),
    start_ms=st.integers(0, 4000),
    jitter=st.lists(st.integers(-5, 5), min_size=300, max_size=300),
)
def test_at_most_one_scan_a_period_and_none_is_missed(
    interval_ms: int, start_ms: int, jitter: list[int]
) -> None:
    stamps = [MS * (start_ms + interval_ms * n + j) for n, j in enumerate(jitter)]
    kept = taken(Thinning(2.0), stamps)
    # Never twice in one period: the first one only sets the beginning.
    gaps = np.diff(kept[1:])
    slack = 2 * interval_ms * MS + 20 * MS
    assert np.all(gaps >= 2 * S - slack)
    assert np.all(gaps <= 2 * S + slack)


@settings(derandomize=True, deadline=None)
@given(jitter=st.lists(st.integers(-50, 50), min_size=30, max_size=30), start=st.integers(0, 4000))
def test_every_scan_of_a_scanner_as_slow_as_the_period_is_taken(
    jitter: list[int], start: int
) -> None:
    stamps = [MS * (start + 2000 * n + j) for n, j in enumerate(jitter)]
    assert taken(Thinning(2.0), stamps) == stamps


def test_without_a_period_every_scan_is_taken() -> None:
    stamps = [40 * MS * n for n in range(10)]
    assert taken(Thinning(0.0), stamps) == stamps


# -- clocks --------------------------------------------------------------------------------


def published(arrivals_ns: list[int], end_ns: int) -> list[tuple[int, bool]]:
    """(when, with a wheel sample) of the poses that a loop on this schedule publishes."""
    schedule = PoseSchedule(50.0, 0)
    now_ns, poses, waiting = 0, [], sorted(arrivals_ns)
    while now_ns < end_ns:
        timer_ns = now_ns + round(1e9 * schedule.wait_s(now_ns))
        came = bool(waiting) and waiting[0] <= timer_ns
        now_ns = max(now_ns, waiting.pop(0)) if came else timer_ns
        if schedule.takes(now_ns, wheels_came=came):
            poses.append((now_ns, came))
    return poses


@settings(derandomize=True, deadline=None)
@given(
    period_us=st.integers(19_900, 20_100),
    jitter_ms=st.lists(st.integers(-4, 4), min_size=500, max_size=500),
    phase_ms=st.integers(0, 20),
)
def test_one_pose_for_each_wheel_sample(
    period_us: int, jitter_ms: list[int], phase_ms: int
) -> None:
    arrivals = [MS * (phase_ms + 10 + j) + 1000 * period_us * n for n, j in enumerate(jitter_ms)]
    settled = [pose for pose in published(arrivals, arrivals[-1]) if pose[0] > arrivals[50]]
    assert all(with_wheels for _, with_wheels in settled)
    assert len(settled) == pytest.approx(449, abs=2)


def test_poses_are_not_more_than_asked_for() -> None:
    poses = published([10 * MS * n for n in range(1000)], 10 * S)
    assert len(poses) == pytest.approx(500, abs=2)
    poses = published([13 * MS * n for n in range(800)], 10 * S)
    assert len(poses) == pytest.approx(500, abs=25)


def test_poses_go_on_at_their_rate_when_wheels_fall_silent() -> None:
    poses = published([20 * MS * n for n in range(100)], 10 * S)
    gaps = np.diff([when for when, _ in poses])
    assert gaps.max() <= 31 * MS
    assert len(poses) == pytest.approx(500, abs=2)


def test_a_stall_is_not_made_up_for() -> None:
    schedule = PoseSchedule(50.0, 0)
    assert schedule.takes(3 * S, wheels_came=True)
    assert not schedule.takes(3 * S + MS, wheels_came=True)
    assert schedule.takes(3 * S + 20 * MS, wheels_came=True)


def test_a_step_of_the_wall_clock_is_counted_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    clock = WallClock()
    before_ns, now_ns = clock.utc_from_monotonic_ns, time.monotonic_ns()
    set_by_ns = 0
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + set_by_ns)
    clock.follow(now_ns + 2 * S)
    assert clock.steps == 0
    set_by_ns = -3600 * S
    clock.follow(now_ns + 2 * S + MS)
    assert clock.steps == 0  # looked at once a pose
    with caplog.at_level(logging.WARNING):
        for second in range(4, 8):
            clock.follow(now_ns + second * S)
    assert clock.steps == 1
    assert len(caplog.records) == 1
    assert clock.utc_from_monotonic_ns - before_ns == pytest.approx(-3600 * S, abs=0.05 * S)


def test_usage_is_that_of_this_process() -> None:
    usage = Usage()
    usage.look([os.getpid()])
    begun_s = time.process_time()
    while time.process_time() - begun_s < 0.2:
        pass
    percent, memory_mb = usage.look([os.getpid(), 2**22 + 1])
    assert 10.0 < percent < 1000.0
    assert 10.0 < memory_mb < 10_000.0


# -- device threads ------------------------------------------------------------------------


class Script:
    """A driver module whose devices do, one after the other, what a test says."""

    Settings = MockSettings

    def __init__(self, *connections: list[WheelSample | Scan | Exception] | Exception) -> None:
        self.connections = list(connections)
        self.opened = 0
        self.closed = 0

    def open_scanner(self, _name: str, settings: object, tap: object) -> Device:
        return self.open_odometry(settings, tap)

    def open_odometry(self, _settings: object, _tap: object) -> Device:
        self.opened += 1
        connection = self.connections.pop(0) if self.connections else LinkLost("gone for good")
        if isinstance(connection, Exception):
            raise connection
        return Device(self, connection)


class Device:
    def __init__(self, script: Script, events: list[WheelSample | Scan | Exception]) -> None:
        self.script = script
        self.events = events

    def read(self, _timeout_s: float) -> WheelSample | Scan | None:
        if not self.events:
            time.sleep(0.001)
            return None
        event = self.events.pop(0)
        if isinstance(event, Exception):
            raise event
        return event

    def info(self) -> DeviceInfo:
        return DeviceInfo(model="script", address="here")

    def status(self) -> tuple[int, str | None]:
        return 2, "standby"

    def close(self) -> None:
        self.script.closed += 1


Got = list[DriveSample | DeviceEnded]


def wheels_of(
    script: Script, monkeypatch: pytest.MonkeyPatch, stale_s: float = 5.0
) -> tuple[WheelsThread, Got]:
    monkeypatch.setattr(registry, "odometry_module", lambda _: script)
    got: Got = []
    return WheelsThread(OdometrySettings(driver="x"), got.append, 5.0, stale_s), got


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def turned(n: int, segment: int = 0) -> WheelSample:
    return WheelSample(stamp_ns=n, left_rad=0.0, right_rad=0.0, segment=segment)


def test_nothing_is_integrated_across_a_reconnection(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    script = Script(
        [turned(1), turned(2, 1), LinkLost("pulled")], LinkLost("not there yet"), [turned(3)]
    )
    thread, got = wheels_of(script, monkeypatch)
    assert thread.health(time.monotonic_ns()).link is Link.LOST
    with caplog.at_level(logging.INFO):
        thread.start()
        until(lambda: len(got) == 3)
        until(lambda: thread.health(time.monotonic_ns()).detail == "standby")
        health = thread.health(time.monotonic_ns())
        thread.ask_to_stop()
        thread.join(DEADLINE_S)
    assert [s.segment for s in got if isinstance(s, WheelSample)] == [0, 1, 2]
    assert (health.link, health.samples, health.errors) == (Link.OK, 3, 6)
    assert script.opened == 3
    assert script.closed == 2
    levels = [(r.levelname, r.getMessage()) for r in caplog.records]
    assert levels == [("WARNING", "wheels: pulled"), ("INFO", "wheels: back")]


def test_silence_is_stale(monkeypatch: pytest.MonkeyPatch) -> None:
    thread, got = wheels_of(Script([turned(1)]), monkeypatch, stale_s=0.05)
    thread.start()
    until(lambda: len(got) == 1)
    until(lambda: thread.health(time.monotonic_ns()).link is Link.STALE)
    assert thread.health(time.monotonic_ns()).age_s is not None
    thread.ask_to_stop()
    thread.join(DEADLINE_S)


def test_settings_that_never_work_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    thread, got = wheels_of(Script(ValueError("no such signal")), monkeypatch)
    thread.start()
    thread.join(DEADLINE_S)
    assert got == [DeviceEnded(name="wheels", unusable="no such signal")]


def test_a_fault_of_the_program_is_told_with_its_traceback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    faults: list[BaseException | None] = []
    monkeypatch.setattr(threading, "excepthook", lambda hook: faults.append(hook.exc_value))
    script = Script([turned(1), KeyError("oh")])
    thread, got = wheels_of(script, monkeypatch)
    thread.start()
    thread.join(DEADLINE_S)
    assert got == [turned(1), DeviceEnded(name="wheels", unusable=None)]
    assert isinstance(faults[0], KeyError)
    assert script.closed == 1


def test_a_scanner_gives_one_scan_a_period_and_counts_all(monkeypatch: pytest.MonkeyPatch) -> None:
    scans: list[WheelSample | Scan | Exception] = [
        Scan(
            scanner="front",
            stamp_ns=40 * MS * n,
            ranges_m=np.ones(3),
            angle_min_rad=0.0,
            angle_step_rad=0.1,
        )
        for n in range(100)
    ]
    script = Script(scans)
    monkeypatch.setattr(registry, "scanner_module", lambda _: script)
    mounting = MountingSettings(x_m=0.0, y_m=0.0, theta_deg=0.0)
    settings = ScannerSettings(name="front", driver="x", poll_period_s=1.0, mounting=mounting)
    got: list[Scan | DeviceEnded] = []
    thread = ScannerThread(settings, got.append, 5.0)
    thread.start()
    until(lambda: thread.health(time.monotonic_ns()).samples == 100)
    thread.ask_to_stop()
    thread.join(DEADLINE_S)
    assert [scan.stamp_ns for scan in got if isinstance(scan, Scan)] == [
        0,
        1 * S,
        2 * S,
        3 * S,
    ]


# -- the unit file -------------------------------------------------------------------------


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_the_unit_and_finds_little_exposed(tmp_path: Path) -> None:
    unit = tmp_path / "amr-slam@amr7.service"
    text = (REPO / "systemd/amr-slam@.service").read_text()
    # The program is not installed where tests run.
    unit.write_text(text.replace("/opt/amr-slam/bin/amr-slam", "/bin/true"))
    verified = subprocess.run(
        ["systemd-analyze", "verify", str(unit)], check=False, capture_output=True, text=True
    )
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    rated = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)],
        check=False,
        capture_output=True,
        text=True,
    )
    exposure = re.search(r"Overall exposure level.*: ([\d.]+)", rated.stdout)
    assert exposure is not None
    assert float(exposure[1]) <= 2.0
