"""One robot on every interface of python-can that works without CAN hardware: the same drives, the
same faults, over real bytes on real lines."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import can
import pytest

from amr_drivers.can_odometry.cia402.driver import Settings, open_odometry
from amr_drivers.can_odometry.cia402.settings import NodeSettings
from amr_drivers.can_odometry.counting import Limits
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.source import CanOdometry
from amr_drivers.emulators.can_faults import BUS_OFF, FaultyWire
from amr_drivers.emulators.cia402 import EmulatedDrives
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_drivers.errors import LinkLost
from amr_slam.samples import WheelSample

DEADLINE_S = 20.0
# Positions alone: the steps come as fast as the machine can, and velocities would be untrue.
WHEEL = NodeSettings(node=1, counts_per_revolution=65536, gear_ratio=20.0, mapping=(0x60640020,))
SETTINGS = Settings(
    left=WHEEL,
    right=replace(WHEEL, node=2, sign=-1),
    sync=True,
    # A loaded machine may pause between any two frames.
    sync_window_s=1.0,
    limits=Limits(max_gap_s=5.0),
)


class Wire(Protocol):
    """The bus seen from the drives' side."""

    settings: Settings

    def send(self, frame: Frame) -> object: ...

    def heard(self) -> list[Frame]: ...


class SlcanWire:
    def __init__(self, adapter: EmulatedSlcan) -> None:
        self.adapter = adapter
        self.settings = replace(SETTINGS, interface="slcan", channel=adapter.port)
        self.send, self.heard = adapter.send, adapter.heard


class MulticastWire:
    def __init__(self, group: str) -> None:
        # All processes of a machine hear all groups on one port: a port for each run.
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", 0))
            self.port = probe.getsockname()[1]
        self.group = group
        self.settings = replace(SETTINGS, interface="udp_multicast", channel=f"{group}@{self.port}")
        options = {"port": self.port, "hop_limit": 0, "ignore_config": True}
        self.bus = can.Bus(interface="udp_multicast", channel=group, **options)
        try:
            # No route to the group is seen when sending, not when opening.
            self.bus.send(can.Message(arbitration_id=1, is_extended_id=False))
        except can.CanError:
            self.bus.shutdown()
            raise

    def send(self, frame: Frame) -> None:
        self.bus.send(
            can.Message(
                arbitration_id=frame.identifier,
                data=frame.data,
                is_extended_id=frame.is_extended,
                is_error_frame=frame.is_error,
            )
        )

    def heard(self) -> list[Frame]:
        frames: list[Frame] = []
        # Its own frames come back, too: those of the host are NMT commands.
        while True:
            try:
                message = self.bus.recv(0.0)
            except can.CanError:  # junk of a test
                continue
            if message is None:
                return frames
            if message.arbitration_id == 0:
                frames.append(Frame(stamp_ns=0, identifier=0, data=bytes(message.data)))


SLCAN = ["slcan on a pty", "slcan over TCP"]
MULTICAST = ["multicast IPv4", "multicast IPv6"]


@pytest.fixture(params=SLCAN + MULTICAST)
def wire(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Wire]:
    with ExitStack() as stack:
        if request.param == "slcan on a pty":
            yield SlcanWire(stack.enter_context(EmulatedSlcan(tmp_path / "can")))
        elif request.param == "slcan over TCP":
            yield SlcanWire(stack.enter_context(EmulatedSlcan.over_tcp()))
        else:
            group = "239.74.163.77" if request.param == "multicast IPv4" else "ff11::7079:77"
            try:
                wire = MulticastWire(group)
            except can.CanError as error:
                pytest.skip(f"this machine has no way to the group {group}: {error}")
            stack.callback(wire.bus.shutdown)
            yield wire


class Robot:
    """Drives that turn by 0.1 and 0.05 rad in each period of the driver's own time."""

    def __init__(self, wire: Wire, told: Settings) -> None:
        self.wire = wire
        self.drives = EmulatedDrives(told)
        self.bus = FaultyWire(wire.send)
        self.driver: CanOdometry = open_odometry(told)
        self.steps = 0
        if isinstance(wire, SlcanWire):
            until(lambda: wire.adapter.is_open)

    def step(self) -> WheelSample | None:
        """A period; the newest sample that it brought."""
        for frame in self.wire.heard():
            self.bus.send(self.drives.hear(frame))
        self.steps += 1
        angles = {"left": 0.1 * self.steps, "right": 0.05 * self.steps}
        self.bus.send(self.drives.cycle(0, angles, 0.02))
        newest = None
        while (sample := self.driver.read(0.05)) is not None:
            assert isinstance(sample, WheelSample)
            newest = sample
        return newest

    def next(self) -> WheelSample:
        got: list[WheelSample] = []

        def came() -> bool:
            sample = self.step()
            got.extend([] if sample is None else [sample])
            return bool(got)

        until(came)
        return got[-1]


@pytest.fixture
def opened(wire: Wire) -> Iterator[Callable[..., Robot]]:
    with ExitStack() as stack:

        def start(**changed: object) -> Robot:
            robot = Robot(wire, replace(wire.settings, **changed))  # type: ignore[arg-type]
            stack.callback(robot.driver.close)
            return robot

        yield start


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.002)


def test_angles_arrive(opened: Callable[..., Robot]) -> None:
    robot = opened()
    first, base = robot.next(), robot.steps
    for _ in range(10):
        before_ns = time.monotonic_ns()
        last = robot.next()
        assert before_ns - 5_000_000 <= last.stamp_ns <= time.monotonic_ns()
    assert last.left_rad - first.left_rad == pytest.approx(0.1 * (robot.steps - base), abs=1e-4)
    assert last.right_rad - first.right_rad == pytest.approx(0.05 * (robot.steps - base), abs=1e-4)
    assert last.segment == first.segment
    errors, text = robot.driver.status()
    assert errors == 0
    assert text is None or "for" in text  # nothing but silence, on a machine that paused


def test_a_drive_that_restarts_is_started_again_over_the_bus(
    opened: Callable[..., Robot],
) -> None:
    robot = opened(start_nodes=True)
    robot.next()
    left = robot.drives.drives["left"]
    robot.bus.send(left.reboot(0))
    after = robot.next()
    assert after.segment == 1
    facts = dict(robot.driver.info().facts)
    assert facts["node 1 restarts"] == "1"


@pytest.mark.parametrize("wire", SLCAN, indirect=True)
def test_the_line_is_lost_and_comes_back(wire: SlcanWire, opened: Callable[..., Robot]) -> None:
    files = len(os.listdir("/proc/self/fd"))
    for _ in range(2):
        robot = opened()
        robot.next()
        wire.adapter.unplug()
        with pytest.raises(LinkLost):
            robot.driver.read(DEADLINE_S)
        robot.driver.close()
        with pytest.raises(LinkLost):
            open_odometry(wire.settings)
        wire.adapter.replug()
    assert len(os.listdir("/proc/self/fd")) == files


@pytest.mark.parametrize("wire", ["slcan over TCP"], indirect=True)
def test_a_converter_that_hangs_is_a_lost_link(opened: Callable[..., Robot]) -> None:
    """Its cable was pulled: no hang-up ever comes over TCP."""
    robot = opened()
    robot.next()
    with pytest.raises(LinkLost, match=r"silent for 2\.\d s"):
        robot.driver.read(DEADLINE_S)


@pytest.mark.parametrize("wire", MULTICAST, indirect=True)
def test_error_frames_reach_the_status(opened: Callable[..., Robot]) -> None:
    robot = opened()
    robot.next()
    robot.bus.fail(0, BUS_OFF)
    assert robot.driver.read(0.2) is None
    assert robot.driver.status() == (1, "bus-off")
    robot.next()
    assert robot.driver.status()[1] != "bus-off"


@pytest.mark.parametrize("wire", MULTICAST, indirect=True)
def test_what_is_no_frame_is_counted_and_survived(
    wire: MulticastWire, opened: Callable[..., Robot]
) -> None:
    robot = opened()
    robot.next()
    family = socket.AF_INET6 if ":" in wire.group else socket.AF_INET
    for junk in (b"junk", b"\xc1", b"", b"\x81\xa1a\x01", bytes(range(200))):
        with socket.socket(family, socket.SOCK_DGRAM) as stranger:
            hops = (
                (socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS)
                if ":" in wire.group
                else (socket.IPPROTO_IP, socket.IP_MULTICAST_TTL)
            )
            stranger.setsockopt(*hops, 0)
            stranger.sendto(junk, (wire.group, wire.port))
        assert robot.driver.read(0.05) is None
    assert robot.driver.status()[0] == 5
    assert robot.next().segment == 0


def test_channels_that_can_never_work_are_named() -> None:
    told = replace(SETTINGS, interface="udp_multicast", channel="239.74.163.77@many")
    with pytest.raises(ValueError, match="GROUP@PORT"):
        open_odometry(told)


def test_an_absent_socketcan_interface_is_a_lost_link() -> None:
    with pytest.raises(LinkLost, match="socketcan"):
        open_odometry(replace(SETTINGS, interface="socketcan", channel="amr-absent0"))
