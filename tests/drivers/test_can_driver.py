from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import can
import pytest
from paths import REPO

from amr_drivers.can_odometry.bus import _stamp_ns
from amr_drivers.can_odometry.driver import Settings, open_odometry
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.source import CanOdometry
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_drivers.emulators.wheels import EmulatedWheels
from amr_drivers.errors import LinkLost
from amr_slam.samples import WheelSample

DEADLINE_S = 10.0
SETTINGS = Settings(
    interface="slcan", dbc=str(REPO / "config/wheels.dbc"), sequence_signal="Sequence"
)


class Robot:
    """Wheels on an adapter; each step turns the left one by 0.1 and the right by -0.05 rad."""

    def __init__(self, link: Path) -> None:
        self.adapter = EmulatedSlcan(link)
        self.wheels = EmulatedWheels(SETTINGS)
        self.drivers: list[CanOdometry] = []
        self.steps = 0

    def frame(self) -> Frame:
        self.steps += 1
        (frame,) = self.wheels.frames(0.1 * self.steps, -0.05 * self.steps)
        return frame

    def step(self) -> None:
        assert self.adapter.send(self.frame())


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    robot = Robot(tmp_path / "can")
    yield robot
    for driver in robot.drivers:
        driver.close()
    robot.adapter.close()


def opened(robot: Robot) -> CanOdometry:
    driver = open_odometry(replace(SETTINGS, channel=robot.adapter.port))
    robot.drivers.append(driver)
    until(lambda: robot.adapter.is_open)
    return driver


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def next_sample(driver: CanOdometry, robot: Robot) -> WheelSample:
    """Steps until one comes through: what waited too long is thrown away on purpose."""
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        driver.read(0.0)
        robot.step()
        sample = driver.read(0.1)
        if sample is not None:
            assert isinstance(sample, WheelSample)
            return sample
    raise AssertionError("no sample")


def test_wheel_angles_arrive_over_a_real_slcan_line(robot: Robot) -> None:
    driver = opened(robot)
    first = next_sample(driver, robot)
    base = robot.steps
    for _ in range(20):
        before_ns = time.monotonic_ns()
        sample = next_sample(driver, robot)
        assert before_ns - 1_000_000 <= sample.stamp_ns <= time.monotonic_ns()
    assert sample.left_rad == pytest.approx(0.1 * (robot.steps - base), abs=0.002)
    assert sample.right_rad == pytest.approx(-0.05 * (robot.steps - base), abs=0.002)
    assert sample.segment == first.segment
    assert driver.status()[1] is None
    info = driver.info()
    assert info.address == robot.adapter.port
    assert dict(info.facts)["frames"] == "0x200"
    driver.close()
    assert not robot.adapter.is_open


@pytest.mark.parametrize(
    "damage",
    [
        b"t20081122\r",  # cut short: dlc 8, 2 bytes
        b"t2\r",
        b"t2008ZZ00000000000000\r",
        b"\xff\xfe\x80",
        b"\a\a\r\r",
        bytes(range(128, 256)) * 4,
    ],
)
def test_damage_on_the_line_is_survived(robot: Robot, damage: bytes) -> None:
    driver = opened(robot)
    next_sample(driver, robot)
    robot.adapter.send_bytes(damage)
    for _ in range(3):
        sample = next_sample(driver, robot)
    assert sample.segment == 0
    assert driver.status()[1] is None
    driver.close()


def test_a_frame_cut_short_is_counted_and_named(robot: Robot) -> None:
    driver = opened(robot)
    next_sample(driver, robot)
    errors = driver.status()[0]
    robot.adapter.send_bytes(b"t20081122\r")
    assert driver.read(0.2) is None
    assert driver.status()[0] == errors + 1
    assert "2 bytes" in str(driver.status()[1])
    driver.close()


def test_silence_is_named(robot: Robot) -> None:
    driver = opened(robot)
    assert driver.read(0.2) is None
    assert "no left and right wheel counts" in str(driver.status()[1])
    next_sample(driver, robot)
    assert driver.status()[1] is None
    driver.close()


def test_unplugging_is_link_lost_and_leaves_no_file_open(robot: Robot) -> None:
    files = len(os.listdir("/proc/self/fd"))
    for _ in range(2):
        driver = opened(robot)
        next_sample(driver, robot)
        robot.adapter.unplug()
        with pytest.raises(LinkLost):
            driver.read(DEADLINE_S)
        driver.close()
        driver.close()
        with pytest.raises(LinkLost):
            open_odometry(replace(SETTINGS, channel=robot.adapter.port))
        robot.adapter.replug()
    assert len(os.listdir("/proc/self/fd")) == files


def test_close_ends_a_waiting_read(robot: Robot) -> None:
    driver = opened(robot)
    ended: list[LinkLost] = []

    def wait() -> None:
        try:
            driver.read(60.0)
        except LinkLost as error:
            ended.append(error)

    reader = threading.Thread(target=wait)
    reader.start()
    driver.close()
    reader.join(DEADLINE_S)
    assert len(ended) == 1


def test_frames_that_waited_are_not_sold_as_new(robot: Robot) -> None:
    driver = opened(robot)
    next_sample(driver, robot)
    driver._bus._back_ns -= 10**9  # as if the reading thread had been away for a second
    robot.step()
    until(lambda: driver._bus._bus.serialPortOrig.in_waiting > 0)  # type: ignore[attr-defined] # slcan's
    assert driver.read(0.1) is None
    driver.close()


def send(bus: can.BusABC, frame: Frame) -> None:
    bus.send(
        can.Message(
            arbitration_id=frame.identifier,
            data=frame.data,
            is_extended_id=frame.is_extended,
            is_error_frame=frame.is_error,
        )
    )


@pytest.fixture
def virtual() -> Iterator[tuple[can.BusABC, CanOdometry]]:
    sender = can.Bus(interface="virtual", channel="wheels", ignore_config=True)
    driver = open_odometry(replace(SETTINGS, interface="virtual", channel="wheels"))
    yield sender, driver
    driver.close()
    sender.shutdown()


def test_error_frames_are_no_data(virtual: tuple[can.BusABC, CanOdometry], robot: Robot) -> None:
    sender, driver = virtual
    send(sender, robot.frame())
    assert driver.read(DEADLINE_S) is not None
    # The error class 0x200 has the id of the wheels' frame, 0x40 says bus-off.
    error = can.Message(arbitration_id=0x240, data=bytes(8), is_error_frame=True)
    sender.send(error)
    assert driver.read(0.05) is None
    assert driver.status() == (1, "bus-off")
    send(sender, robot.frame())
    assert driver.read(DEADLINE_S) is not None
    assert driver.status()[1] is None


@pytest.mark.parametrize("offset_s", [3600.0, 0.01, -3600.0, -1.7e9])
def test_a_stamp_of_another_clock_is_replaced(offset_s: float) -> None:
    before_ns = time.monotonic_ns()
    stamp_ns = _stamp_ns(time.time() + offset_s)
    assert before_ns <= stamp_ns <= time.monotonic_ns()


def test_a_frame_that_waited_in_the_kernel_keeps_its_stamp() -> None:
    now_ns = time.monotonic_ns()
    assert _stamp_ns(time.time() - 0.25) - now_ns == pytest.approx(-250e6, abs=50e6)


def test_an_interface_that_does_not_exist_is_a_mistake_in_the_settings() -> None:
    with pytest.raises(ValueError, match="carrier_pigeon"):
        open_odometry(replace(SETTINGS, interface="carrier_pigeon"))


@pytest.mark.parametrize("code", [100, 19])  # ENETDOWN, ENODEV: ip link set down, ip link del
def test_an_interface_that_goes_down_is_a_lost_link(
    virtual: tuple[can.BusABC, CanOdometry], code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, driver = virtual

    def down(timeout: float | None) -> None:
        raise can.CanOperationError("Network is down", code)

    monkeypatch.setattr(driver._bus._bus, "_recv_internal", down)
    with pytest.raises(LinkLost, match="Network is down"):
        driver.read(DEADLINE_S)


def test_socketcan_filters_in_the_kernel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What cannot be opened here is at least asked for as the kernel wants it."""
    asked: list[dict[str, object]] = []

    def bus(**options: object) -> can.BusABC:
        asked.append(options)
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(can, "Bus", bus)
    with pytest.raises(LinkLost, match=r"socketcan can0: .*Address family"):
        open_odometry(replace(SETTINGS, interface="socketcan", channel="can0"))
    assert asked[0]["can_filters"] == [{"can_id": 0x200, "can_mask": 0x7FF, "extended": False}]
    assert asked[0]["channel"] == "can0"
