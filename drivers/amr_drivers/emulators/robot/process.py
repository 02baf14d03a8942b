"""The emulated robot in a process of its own, and the remote control of it.

Lines of text on its pipes: ``v_mps omega_radps`` on standard input, the truth as
``monotonic_ns x_m y_m theta_rad`` on standard output, 50 a second. It stops like a drive without a
controller when no command comes, and ends when its standard input does: whoever started it may
die in any way, no robot and no port stays behind.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Self, TextIO

import numpy as np

from amr_drivers.emulators.robot.devices import EmulatedRobot, RobotModel
from amr_drivers.errors import LinkLost, LinkTimeout
from amr_slam.geometry import Pose2
from amr_slam.recording import Trajectory
from amr_slam.simulation import WHEEL_PERIOD_NS

COMMAND_TIMEOUT_S = 0.3
"""A command older than this is none: the robot brakes."""
_MAX_SPEED_MPS = 2.0
_MAX_TURN_RADPS = 3.0
_END_S = 5.0
"""How long the process may take to end once it is told to."""


class RobotProcess:
    """Starts the robot and holds its remote control. A context manager."""

    def __init__(
        self,
        directory: Path,
        dbc: str,
        seed: int,
        *,
        ready_timeout_s: float = 30.0,
    ) -> None:
        """Returns when the ports are there and the robot runs: ``RobotModel(seed=seed)``.

        Raises LinkTimeout or LinkLost when it does not come up.
        """
        self._moved = threading.Condition()
        self._truth: list[tuple[int, float, float, float]] = []
        self._ended = False
        module = "amr_drivers.emulators.robot"
        command = [sys.executable, "-m", module, str(directory), dbc, str(seed)]
        # Its own session: Ctrl-C at a terminal is for the one who started it to handle.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdin is not None
        self._commands = self._process.stdin
        self._thread = threading.Thread(
            target=self._follow, args=(self._process.stdout,), name="robot-truth", daemon=True
        )
        self._thread.start()
        with self._moved:
            is_up = self._moved.wait_for(lambda: self._truth or self._ended, ready_timeout_s)
        if not is_up or self._ended:
            self.close()
            kind = LinkLost if is_up else LinkTimeout
            raise kind(f"the emulated robot in {directory} did not start")

    def drive(self, v_mps: float, omega_radps: float) -> None:
        """Command forward and turning speed. Raises LinkLost when the robot is gone."""
        try:
            self._commands.write(f"{v_mps!r} {omega_radps!r}\n")
            self._commands.flush()
        except (BrokenPipeError, ValueError) as error:
            raise LinkLost(f"the emulated robot has ended: {error}") from error

    def truth(self) -> Trajectory:
        """Where the robot really was so far: ``map_from_base`` at ``time.monotonic_ns()``."""
        with self._moved:
            rows = list(self._truth)
        return Trajectory(
            stamps_ns=np.array([row[0] for row in rows], dtype=np.int64),
            poses=np.array([row[1:] for row in rows], dtype=np.float64).reshape(-1, 3),
        )

    def paused_s(self) -> float:
        """For how long the world stood still because the processor was late."""
        excess_ns = np.diff(self.truth().stamps_ns) - WHEEL_PERIOD_NS
        return 1e-9 * float(excess_ns.sum())

    def close(self) -> None:
        """End the process, which removes its ports. Idempotent."""
        with contextlib.suppress(BrokenPipeError):
            self._commands.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _follow(self, lines: TextIO) -> None:
        with lines:
            for line in lines:
                stamp, x, y, theta = line.split()
                with self._moved:
                    self._truth.append((int(stamp), float(x), float(y), float(theta)))
                    self._moved.notify_all()
        with self._moved:
            self._ended = True
            self._moved.notify_all()


def serve(directory: Path, dbc: str, model: RobotModel) -> None:
    """Be the robot until standard input ends. Raises ValueError for a line that is no command."""
    # Whoever started it ends it; Ctrl-C would take the robot away before the daemon has stopped.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    commands = _Commands(sys.stdin.fileno())
    with EmulatedRobot(directory, dbc, model) as robot, contextlib.suppress(BrokenPipeError):
        while (command := commands.newest()) is not None:
            stamp_ns, pose = robot.step(*command)
            _tell(stamp_ns, pose)


def _tell(stamp_ns: int, pose: Pose2) -> None:
    sys.stdout.write(f"{stamp_ns} {pose.x_m!r} {pose.y_m!r} {pose.theta_rad!r}\n")
    sys.stdout.flush()


class _Commands:
    """Commands from a file descriptor, read without waiting."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""
        self._command = (0.0, 0.0)
        self._heard_s = -math.inf

    def newest(self) -> tuple[float, float] | None:
        """What to drive now: (0, 0) without a fresh command, None at the end of the input."""
        while select.select([self._descriptor], [], [], 0.0)[0]:
            data = os.read(self._descriptor, 4096)
            if not data:
                return None
            *lines, rest = (self._rest + data).split(b"\n")
            self._rest = rest[-200:]
            if lines:
                self._command, self._heard_s = _parse(lines[-1]), time.monotonic()
        is_fresh = time.monotonic() - self._heard_s <= COMMAND_TIMEOUT_S
        return self._command if is_fresh else (0.0, 0.0)


def _parse(line: bytes) -> tuple[float, float]:
    v_mps, omega_radps = (float(word) for word in line.split())
    if not (abs(v_mps) <= _MAX_SPEED_MPS and abs(omega_radps) <= _MAX_TURN_RADPS):
        raise ValueError(f"{line!r}: beyond {_MAX_SPEED_MPS} m/s or {_MAX_TURN_RADPS} rad/s")
    return v_mps, omega_radps
