"""The wheels of whole configurations, seen by ``amr-slam check --probe`` and by their drives."""

from __future__ import annotations

import re
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Self

import pytest
from paths import REPO

from amr_drivers import registry
from amr_drivers.can_odometry.cia402.settings import Settings as Cia402Settings
from amr_drivers.can_odometry.settings import Settings
from amr_drivers.emulators.can_faults import BUS_OFF
from amr_drivers.emulators.odometry import EmulatedOdometry, emulate
from amr_drivers.emulators.ports import free_port
from amr_drivers.errors import LinkLost
from amr_slam import config
from amr_slam.samples import DriveSample, OdometrySource
from amr_slam.service import probe

PERIOD_S = 0.02


class Pushed:
    """A robot that somebody pushes: its joints turn by these radians a second."""

    def __init__(self, device: EmulatedOdometry, *radps: float) -> None:
        self._device = device
        self._radps = radps
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._push)

    def _push(self) -> None:
        start_s = last_s = time.monotonic()
        while not self._stop.wait(PERIOD_S):
            now_s = time.monotonic()
            angles = [rate * (now_s - start_s) for rate in self._radps]
            self._device.turn(*angles, dt_s=now_s - last_s)
            last_s = now_s

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._stop.set()
        self._thread.join()


def told(file: str, channel: str) -> config.Config:
    loaded = config.load(REPO / "config" / file)
    options = replace(loaded.odometry.options, channel=channel)
    return replace(loaded, odometry=replace(loaded.odometry, options=options))


@pytest.mark.parametrize(
    ("file", "radps", "line"),
    [
        ("demo.toml", (1.0, 2.0), r"turned left \+(\d\.\d\d) rad, right \+(\d\.\d\d) rad"),
        ("cia402.toml", (1.0, 2.0), r"turned left \+(\d\.\d\d) rad, right \+(\d\.\d\d) rad"),
        ("tricycle.toml", (-2.0, 0.1), r"turned drive -(\d\.\d\d) rad, steer \+(\d\.\d\d) rad"),
    ],
)
def test_a_probe_shows_wheels_that_are_pushed(
    file: str,
    radps: tuple[float, float],
    line: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(REPO)
    monkeypatch.setattr(probe, "PROBE_S", 2.0)
    robot = told(file, str(tmp_path / "can"))
    with emulate(robot.odometry.options) as device, Pushed(device, *radps):
        assert probe.check(robot, REPO / "config" / file, probe=True) == 1
    wheels = capsys.readouterr().out.splitlines()[-1]
    assert wheels.startswith("wheels: ")
    found = re.search(line, wheels)
    assert found is not None, wheels
    first, second = (float(number) for number in found.groups())
    assert first > 0.2
    assert second == pytest.approx(first * abs(radps[1] / radps[0]), abs=0.03)
    assert " value " in wheels  # the counts themselves


@pytest.mark.parametrize("file", ["demo.toml", "cia402.toml", "tricycle.toml"])
@pytest.mark.parametrize("over_tcp", [False, True], ids=["pty", "tcp"])
def test_the_emulator_stands_in_for_what_a_driver_reads(
    file: str, over_tcp: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(REPO)
    channel = "socket://127.0.0.1:0" if over_tcp else str(tmp_path / "can")
    robot = told(file, channel)
    with emulate(robot.odometry.options) as device:
        options = replace(robot.odometry.options, channel=device.adapter.port)
        driver = registry.odometry_module(robot.odometry.driver).open_odometry(options)
        try:
            with Pushed(device, 1.0, 0.5):
                samples: list[DriveSample] = []
                deadline_s = time.monotonic() + 20.0
                while len(samples) < 5:
                    assert time.monotonic() < deadline_s
                    sample = driver.read(0.5)
                    samples += [] if sample is None else [sample]
            motion = robot.drive.motion(samples[0], samples[-1])
            assert not motion.gap
            assert motion.delta.x_m > 0.0
        finally:
            driver.close()


def test_wheels_that_restart_count_from_0_as_a_new_segment(tmp_path: Path) -> None:
    settings = Settings(
        interface="slcan", channel=str(tmp_path / "can"), dbc=str(REPO / "config/wheels.dbc")
    )
    with emulate(settings) as device:
        driver = registry.odometry_module("can").open_odometry(settings)
        try:
            before = turned(device, driver, 9.0)
            device.restart()
            after = turned(device, driver, 9.5)
            assert after.segment > before.segment
        finally:
            driver.close()
    with (
        emulate(Cia402Settings(interface="slcan", channel=str(tmp_path / "can"))) as drives,
        pytest.raises(TypeError, match="one by one"),
    ):
        drives.restart()


def turned(device: EmulatedOdometry, driver: OdometrySource, angle_rad: float) -> DriveSample:
    """What is read once both wheels have come there."""
    deadline_s = time.monotonic() + 20.0
    while True:
        assert time.monotonic() < deadline_s
        device.turn(angle_rad, angle_rad, dt_s=PERIOD_S)
        sample = driver.read(0.05)
        if sample is not None:
            return sample


def test_a_multicast_bus_passes_error_frames_on() -> None:
    settings = Settings(
        interface="udp_multicast",
        channel=f"239.74.163.2@{free_port()}",
        dbc=str(REPO / "config/wheels.dbc"),
    )
    try:
        device = emulate(settings)
    except LinkLost as error:
        pytest.skip(f"no multicast on this machine: {error}")
    with device:
        driver = registry.odometry_module("can").open_odometry(settings)
        try:
            turned(device, driver, 1.0)
            device.wire.fail(time.monotonic_ns(), BUS_OFF)
            deadline_s = time.monotonic() + 20.0
            while driver.status()[1] != "bus-off":
                assert time.monotonic() < deadline_s
                driver.read(0.05)
            assert device.adapter.heard()
        finally:
            driver.close()


def test_other_interfaces_are_refused() -> None:
    with pytest.raises(ValueError, match="virtual cannot be emulated"):
        emulate(Settings(dbc="config/wheels.dbc", interface="virtual"))
    with pytest.raises(ValueError, match="virtual cannot be emulated"):
        emulate(Cia402Settings(interface="virtual"))


def test_a_can_interface_must_be_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """With frames on it: tests/system, in a machine that has CAN."""
    monkeypatch.chdir(REPO)
    with pytest.raises(OSError, match=r"\[Errno"):
        emulate(Settings(dbc="config/wheels.dbc", channel="no-such-can"))
