"""Rows 9 to 15: the CAN bus, and the wheels behind it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from amr_drivers.can_odometry.frames import Frame
from amr_drivers.emulators.can_faults import BUS_OFF
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_slam.samples import WheelSample
from amr_slam.studies.faults.row import Row, either, fault_says
from amr_slam.studies.faults.rows.places import DOUBTS
from amr_slam.studies.faults.rows.scanners import GOES_ON, POSE_S
from amr_slam.studies.faults.settings import Setting
from amr_slam.studies.faults.stage import Stage, is_localized
from amr_slam.studies.faults.witness import Message
from amr_slam.wire import StatusMessage

_SLIP_M: Final = 0.4
_SLIP_S: Final = 0.3
_RADIUS_M: Final = 0.1
_SLIPS: Final = either(
    *map(fault_says, ("wheels slip", "wheel slips", "wheel stuck", "fits, but elsewhere")), DOUBTS
)


@contextmanager
def _disturbed(
    stage: Stage, disturb: Callable[[WheelSample], WheelSample | None]
) -> Iterator[None]:
    stage.robot.surroundings.disturb_wheels = disturb
    try:
        yield
    finally:
        stage.robot.surroundings.disturb_wheels = lambda wheels: wheels


@contextmanager
def _bus_off(stage: Stage) -> Iterator[None]:
    wire = stage.robot.wheels.wire
    wire.silent = True
    wire.fail(time.monotonic_ns(), BUS_OFF)
    try:
        yield
    finally:
        wire.silent = False


@contextmanager
def _silence(stage: Stage) -> Iterator[None]:
    with _disturbed(stage, lambda _: None):
        yield


@contextmanager
def _removed(stage: Stage) -> Iterator[None]:
    adapter = stage.robot.wheels.adapter
    assert isinstance(adapter, EmulatedSlcan)
    adapter.unplug()
    try:
        yield
    finally:
        adapter.replug()


@contextmanager
def _mixed_up(stage: Stage) -> Iterator[None]:
    """One frame comes twice, the next one after its successor, and so on."""
    wheels = stage.robot.wheels
    ways = itertools.cycle([wheels.wire.send_twice, wheels.wire.send, wheels.wire.hold])

    def pass_on(frames: Sequence[Frame]) -> None:
        next(ways)(frames)

    wheels.pass_on = pass_on
    try:
        yield
    finally:
        wheels.pass_on = wheels.wire.send


@contextmanager
def _restarted(stage: Stage) -> Iterator[None]:
    stage.robot.wheels.restart()
    yield


@contextmanager
def _stuck(stage: Stage) -> Iterator[None]:
    stuck: list[float] = []
    lost_rad = 0.0

    def hold(wheels: WheelSample) -> WheelSample:
        nonlocal lost_rad
        stuck.append(wheels.left_rad)
        lost_rad = stuck[0] - wheels.left_rad
        return replace(wheels, left_rad=stuck[0])

    with _disturbed(stage, hold):
        yield
    # An encoder that turns again goes on from where it was.
    stage.robot.surroundings.disturb_wheels = lambda w: replace(w, left_rad=w.left_rad + lost_rad)


@contextmanager
def _slipping(stage: Stage) -> Iterator[None]:
    begun_ns: list[int] = []

    def spin(wheels: WheelSample) -> WheelSample:
        begun_ns.append(wheels.stamp_ns)
        part = min(1.0, 1e-9 * (wheels.stamp_ns - begun_ns[0]) / _SLIP_S)
        extra_rad = part * _SLIP_M / _RADIUS_M
        return replace(
            wheels, left_rad=wheels.left_rad + extra_rad, right_rad=wheels.right_rad + extra_rad
        )

    stage.robot.surroundings.disturb_wheels = spin  # for good: what was turned, was turned
    yield


def _counts(message: Message) -> bool:
    """Frames that were no use: there are none before."""
    return isinstance(message, StatusMessage) and message.wheels.errors > 0


_SILENT: Final = fault_says("wheels silent")

WHEELS: Final = (
    Row(
        number="9", fault="CAN bus-off: error frame, then silence for 4 s", inject=_bus_off,
        sign="fault: bus-off", says=fault_says("bus-off"), within_s=0.1 + POSE_S,
        setting=Setting(can="udp_multicast"), back_scans=2,
        elsewhere="SocketCAN and the kernel's restart-ms",
    ),
    Row(
        number="10", fault="CAN silent for 4 s, robot drives on", inject=_silence,
        sign="fault: wheels silent", says=_SILENT, within_s=0.1 + POSE_S,
    ),
    Row(
        number="11", fault="CAN adapter removed and back", inject=_removed,
        sign="fault: wheels lost", says=fault_says("wheels lost"), within_s=0.5,
        elsewhere="interface down and gone: ENETDOWN, ENODEV",
    ),
    Row(
        number="12", fault="CAN frames twice and out of order", inject=_mixed_up,
        sign="health: errors counted", says=_counts, within_s=1.2, stays=GOES_ON,
    ),
    Row(
        number="13", fault="encoders restart at 0; 16-bit counters wrap in every row",
        inject=_restarted, sign="", lasts_s=4.0, stays=GOES_ON,
    ),
    Row(
        number="14", fault="left encoder stuck", inject=_stuck,
        sign="fault: wheel stuck or slips; or doubts the pose",
        says=_SLIPS, within_scans=2, within_s=0.3, lasts_s=6.0, back=is_localized, back_scans=3,
    ),
    Row(
        number="15", fault=f"wheels slip by {_SLIP_M:g} m in {_SLIP_S:g} s", inject=_slipping,
        sign="fault: wheels slip; or doubts the pose", says=_SLIPS, within_scans=1, within_s=0.3,
        back=is_localized,
    ),
)  # fmt: skip
