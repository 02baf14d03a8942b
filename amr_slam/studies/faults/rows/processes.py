"""Rows 16, 18, 20 and 32: the computer, its clock and its processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from amr_slam.states import State
from amr_slam.studies.faults.row import Row, fault_says, state_is
from amr_slam.studies.faults.rows.scanners import GOES_ON
from amr_slam.studies.faults.settings import ROBOT, Setting
from amr_slam.studies.faults.stage import Stage, StageError, is_localized
from amr_slam.studies.faults.witness import Message, Presence
from amr_slam.wire import PoseMessage, StatusMessage

_HOUR_S: Final = 3600.0
_WATCHDOG_S: Final = 2.0
"""Of the unit file."""
_LISTENER: Final = """
import sys
from amr_slam.client import FleetListener
with FleetListener(sys.argv[1], [sys.argv[2]]) as fleet:
    while fleet.next_pose(60.0) is not None:
        print("heard", flush=True)
"""


@contextmanager
def _clock_set(stage: Stage) -> Iterator[None]:
    stage.set_clock(_HOUR_S)
    yield
    # An operator's mistake is put right; the second step is the same fault once more.
    stage.set_clock(0.0)


def _tells_step(message: Message) -> bool:
    return isinstance(message, StatusMessage) and message.clock_steps > 0


@contextmanager
def _overload(stage: Stage) -> Iterator[None]:
    worker = stage.slam()
    os.kill(worker, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(worker, signal.SIGCONT)


@contextmanager
def _slow_listener(stage: Stage) -> Iterator[None]:
    command = [sys.executable, "-c", _LISTENER, stage.endpoint, ROBOT]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as listener:
        try:
            assert listener.stdout is not None
            if listener.stdout.readline() != "heard\n":
                raise StageError("the second listener hears nothing")
            listener.send_signal(signal.SIGSTOP)
            stage.mark()
            yield
        finally:
            listener.kill()


@contextmanager
def _slam_killed(stage: Stage) -> Iterator[None]:
    os.kill(stage.slam(), signal.SIGKILL)
    yield


@contextmanager
def _slam_hangs(stage: Stage) -> Iterator[None]:
    """Nobody wakes it up: its end is the cure."""
    os.kill(stage.slam(), signal.SIGSTOP)
    yield


@contextmanager
def _daemon_killed(stage: Stage) -> Iterator[None]:
    stage.kill_daemon()
    yield
    _restart(stage)


@contextmanager
def _daemon_hangs(stage: Stage) -> Iterator[None]:
    os.kill(stage.daemon.pid, signal.SIGSTOP)
    stage.mark()
    yield
    stage.rest(_WATCHDOG_S - 1.0)
    stage.kill_daemon()
    _restart(stage)


def _restart(stage: Stage) -> None:
    """What systemd does, and how long it takes to the first pose."""
    begin_ns = time.monotonic_ns()
    stage.start_daemon()
    pose = stage.witness.wait_for(lambda one: isinstance(one, PoseMessage), begin_ns, 60.0)
    if pose is None:
        raise StageError(f"no pose after a restart; see {stage.log}")
    stage.notes.append(f"first pose after {1e-9 * (pose.received_ns - begin_ns):.1f} s")


def gone(message: Message) -> bool:
    """The fleet sees that the robot is not there."""
    return isinstance(message, Presence) and not message.alive


PROCESSES: Final = (
    Row(
        number="16", fault="UTC set by an hour, and back", inject=_clock_set,
        sign="status: clock_steps", says=_tells_step, within_s=0.2, stays=GOES_ON,
        setting=Setting(clocked=True), elsewhere="the kernel's clock itself",
    ),
    Row(
        number="18", fault="SLAM process stopped for 7 s", inject=_overload, sign="odometry_only",
        says=state_is(State.ODOMETRY_ONLY), within_s=5.0, lasts_s=7.0,
    ),
    Row(
        number="20", fault="a listener that hangs", inject=_slow_listener, sign="", lasts_s=8.0,
        stays=GOES_ON, elsewhere="delay and loss on the network",
    ),
    Row(
        number="32a", fault="SLAM process: kill -9", inject=_slam_killed,
        sign="fault: slam: killed", says=fault_says("slam: killed by SIGKILL"), within_s=0.5,
        lasts_s=0.5, back_s=10.0,
    ),
    Row(
        number="32b", fault="SLAM process hangs for ever", inject=_slam_hangs,
        sign="fault: slam: no answer", says=fault_says("slam: no answer within 12 s"),
        within_s=12.5, within_scans=1, lasts_s=1.0, back_s=10.0,
    ),
    Row(
        number="32c", fault="daemon: kill -9, started again", inject=_daemon_killed,
        sign="alive token falls", says=gone, within_s=1.5, lasts_s=0.0, back=is_localized,
        back_s=10.0, back_scans=0,
        restarts=True, elsewhere="systemd's restart",
    ),
    Row(
        number="32d", fault="daemon hangs, ended and started again", inject=_daemon_hangs,
        sign="alive token falls", says=gone, within_s=1.5, lasts_s=0.0, back=is_localized,
        back_s=10.0, back_scans=0,
        restarts=True, elsewhere="systemd's watchdog",
    ),
)  # fmt: skip
