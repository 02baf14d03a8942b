"""A trial of the whole way: the daemon as its users start it, and a robot driven by its poses."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, Self

from amr_slam.client import FleetListener, SessionError
from amr_slam.judging import ReportedPose
from amr_slam.reporting import map_from_base
from amr_slam.simulation import CautiousPilot
from amr_slam.wire import PoseMessage

_ATTEMPT_S: Final = 1.0
_STOP_S: Final = 20.0
"""A clean stop finishes the running registration and saves the map."""
_POSE_WAIT_S: Final = 0.1
_SIGMAS_95: Final = 1.96


class TrialError(Exception):
    """The daemon did not come up or did not stop cleanly: one line, with the place of its log."""


class DaemonProcess:
    """``amr-slam run`` in a process of its own. A context manager; leaving it stops the daemon."""

    def __init__(
        self, config: Path, log: Path, program: Sequence[str] = ("-m", "amr_slam")
    ) -> None:
        """``log``: where its standard output and error go. Relative paths in ``config`` start at
        the working directory. ``program``: what Python is to run, and what stands before ``run``.
        """
        self._log = log
        command = [sys.executable, *program, "run", "--config", str(config)]
        with log.open("w", encoding="utf-8") as stream:
            # Its own session: Ctrl-C at a terminal is for the one who started it to handle.
            self._process = subprocess.Popen(
                command, stdout=stream, stderr=stream, start_new_session=True
            )

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """For who kills it, or looks at what it uses."""
        return self._process

    @property
    def pid(self) -> int:
        """Of the daemon, not of its SLAM process."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Its exit status; None while it runs."""
        return self._process.poll()

    def listener(
        self, endpoint: str, robot: str, timeout_s: float = 30.0, keys: Path | None = None
    ) -> FleetListener:
        """Listen to the daemon's robot, which may still be starting.

        Raises TrialError when the daemon ends or does not answer in time.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            self.check()
            try:
                return FleetListener(endpoint, [robot], keys=keys, connect_timeout_s=_ATTEMPT_S)
            except SessionError as error:
                if time.monotonic() > deadline_s:
                    raise TrialError(f"{error}; see {self._log}") from error

    def check(self) -> None:
        """Raises TrialError when the daemon has ended."""
        status = self._process.poll()
        if status is not None:
            raise TrialError(f"the daemon ended with status {status}; see {self._log}")

    def stop(self) -> None:
        """Stop it as systemd does. Raises TrialError when it does not end cleanly. Idempotent."""
        self._process.terminate()
        try:
            status = self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise TrialError(f"the daemon did not stop in {_STOP_S:g} s; see {self._log}") from None
        if status != 0:
            raise TrialError(f"the daemon ended with status {status}; see {self._log}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if error is None:
            self.stop()
            return
        # The error on its way says more than how the daemon takes its end.
        with contextlib.suppress(TrialError):
            self.stop()

    def kill(self) -> None:
        """The whole session: its worker, too. Idempotent."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def adapted_config(template: Path, replacements: Mapping[str, str], out: Path) -> Path:
    """A copy of a configuration with other beginnings of its quoted texts; returns ``out``.

    Raises ValueError when the template has none of a text.
    """
    text = template.read_text(encoding="utf-8")
    for old, new in replacements.items():
        if f'"{old}' not in text:
            raise ValueError(f"{template} names no {old}")
        text = text.replace(f'"{old}', f'"{new}')
    out.write_text(text, encoding="utf-8")
    return out


def drive(
    daemon: DaemonProcess,
    listener: FleetListener,
    pilot: CautiousPilot,
    command: Callable[[float, float], None],
    seconds: float,
) -> Iterator[ReportedPose]:
    """Steer by each pose as it comes in, for ``seconds``; yields what it steered by.

    ``command`` takes m/s and rad/s. Without poses the robot is told to stand. Raises TrialError
    when the daemon ends.
    """
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        message = listener.next_pose(_POSE_WAIT_S)
        if message is None:
            daemon.check()
            command(0.0, 0.0)
            continue
        report = reported(message, time.time_ns(), time.monotonic_ns())
        age_s = 1e-9 * (report.received_ns - report.stamp_ns)
        command(*pilot.command(report.map_from_base, report.state, age_s))
        yield report
    command(0.0, 0.0)


def reported(message: PoseMessage, utc_ns: int, monotonic_ns: int) -> ReportedPose:
    """A message on the monotonic clock of this machine; both clocks as read on its reception."""
    age_ns = utc_ns - round(1e9 * message.stamp)
    return ReportedPose(
        seq=message.seq,
        stamp_ns=monotonic_ns - age_ns,
        received_ns=monotonic_ns,
        map_from_base=map_from_base(message),
        error95_m=message.error95_m,
        heading95_rad=_SIGMAS_95 * math.sqrt(max(0.0, message.covariance[8])),
        state=message.state,
    )
