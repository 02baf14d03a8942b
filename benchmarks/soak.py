"""A whole daemon at speed for half an hour: memory, descriptors, processor, and the poses' period.

The demo's robot drives a circle (wheels at 50 Hz over CAN frames, two scanners at 0.5 Hz); the
daemon has mapped the laboratory and is started anew in that map. Both processes are looked at each
five seconds; the memory's slope is a straight line through the least of each minute that they hold
alone (USS; a look in the middle of a search finds 2 MB more), once the recording's ring is full.
Period: between a pose's arrival here and that of the one before it, between the instants at which
they were made, and between the wheel frames that they were made of: as even as the emulated robot
sends them, and the wheels' driver notes them.
Example: python benchmarks/soak.py --minutes 30
"""

from __future__ import annotations

import argparse
import os
import re
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import psutil  # type: ignore[import-untyped]  # comes without types

from amr_drivers.emulators.robot import RobotModel, RobotProcess
from amr_slam.client import FleetListener
from amr_slam.geometry import Array
from amr_slam.trial import DaemonProcess, TrialError, adapted_config
from amr_slam.wire import PoseMessage

REPO: Final = Path(__file__).resolve().parent.parent
ROBOT: Final = "demo"
_MAPPING_S: Final = 60.0
_LOOK_S: Final = 5.0
_WAIT_S: Final = 120.0


@dataclass(slots=True)
class Poses:
    """What came, as it came: noted on zenoh's thread."""

    listener: FleetListener | None = None
    arrived_s: list[float] = field(default_factory=list)
    made_s: list[float] = field(default_factory=list)
    wheels_s: list[float] = field(default_factory=list)
    states: dict[str, int] = field(default_factory=dict)
    _seq: int = -1

    def note(self, robot: str) -> None:
        """Something of the robot came: a pose?"""
        pose = None if self.listener is None else self.listener.view(robot).pose
        if pose is None or pose.seq == self._seq:
            return
        self._seq = pose.seq
        self.arrived_s.append(time.monotonic())
        self.made_s.append(pose.stamp + pose.age_s)
        self.wheels_s.append(pose.stamp)
        self.states[pose.state.value] = self.states.get(pose.state.value, 0) + 1


@dataclass(slots=True)
class Looks:
    """The daemon and its SLAM process: a row for each look."""

    daemon: psutil.Process
    rows: list[list[float]] = field(default_factory=list)

    def look(self) -> None:
        """Time in s; then for either process USS in MB, descriptors, processor time in s."""
        row = [time.monotonic()]
        slam = next(c for c in self.daemon.children() if "spawn_main" in " ".join(c.cmdline()))
        for process in (self.daemon, slam):
            used = process.cpu_times()
            row += [process.memory_full_info().uss / 1e6, process.num_fds(), used[0] + used[1]]
        self.rows.append(row)


def main() -> int:
    """Measure and print a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--warm-up", type=float, default=12.0, metavar="MIN", help="of these")
    arguments = parser.parse_args()
    unit = (REPO / "systemd/amr-slam@.service").read_text("utf-8")
    os.environ.update(re.findall(r"(MALLOC_\w+)=(\S+)", unit))  # as the service runs
    with tempfile.TemporaryDirectory() as scratch:
        out, endpoint = Path(scratch), free_endpoint()
        own = {"tcp/127.0.0.1:7447": endpoint, "out/demo": str(out), "config": str(REPO / "config")}
        config = adapted_config(REPO / "config/demo.toml", own, out / "robot.toml")
        with RobotProcess(out, str(REPO / "config/wheels.dbc"), RobotModel().seed) as robot:
            robot.drive(0.1, 0.3)
            with DaemonProcess(config, out / "daemon.log") as daemon:
                first(daemon, endpoint, "mapping")
                time.sleep(_MAPPING_S)
            mode = f'mode = "localization"\npath = "{out}/demo.amrmap"'
            config.write_text(config.read_text("utf-8").replace('mode = "mapping"', mode), "utf-8")
            begun_s = time.monotonic()
            with DaemonProcess(config, out / "daemon.log") as daemon:
                first_s, localized_s = first(daemon, endpoint, "localized")
                print(f"cold start: first pose {first_s - begun_s:.1f} s,", end=" ")
                print(f"localized {localized_s - begun_s:.1f} s", flush=True)
                tell(*watched(daemon, endpoint, 60.0 * arguments.minutes), arguments.warm_up)
    return 0


def first(daemon: DaemonProcess, endpoint: str, state: str) -> tuple[float, float]:
    """When the first pose came, and the first in that state. Raises TrialError."""
    with daemon.listener(endpoint, ROBOT, _WAIT_S) as listener:
        until(listener, lambda _: True)
        first_s = time.monotonic()
        until(listener, lambda pose: pose.state.value == state)
        return first_s, time.monotonic()


def watched(daemon: DaemonProcess, endpoint: str, seconds: float) -> tuple[Poses, Looks]:
    """Listen and look for so long."""
    poses, looks = Poses(), Looks(psutil.Process(daemon.pid))
    with FleetListener(endpoint, [ROBOT], on_change=poses.note) as poses.listener:
        end, pause = time.monotonic() + seconds, threading.Event()
        while time.monotonic() < end:
            daemon.check()
            looks.look()
            pause.wait(_LOOK_S)
    return poses, looks


def tell(poses: Poses, looks: Looks, warm_up_min: float) -> None:
    """The tables."""
    rows = np.array(looks.rows)
    minutes = (rows[:, 0] - rows[0, 0]) / 60.0
    warm = minutes >= min(warm_up_min, 0.5 * minutes[-1])
    load, measured_min = os.getloadavg()[0], np.ptp(minutes[warm])
    print(
        f"\nload average {load:.1f}, {os.cpu_count()} processors, {minutes[-1]:.1f} min;", end=" "
    )
    print(f"slope and shares over the last {measured_min:.1f}\n")
    print("| process | memory MB, end | MB/h | descriptors, least and most | share of a core |")
    print("|---|--:|--:|--:|--:|")
    for name, k in (("daemon", 1), ("SLAM process", 4)):
        memory, descriptors, used = rows[warm, k], rows[warm, k + 1], rows[warm, k + 2]
        slope = np.polyfit(*least(minutes[warm], memory), 1)[0]
        share = (used[-1] - used[0]) / (60.0 * np.ptp(minutes[warm]))
        print(f"| {name} | {memory[-1]:.1f} | {slope:+.2f} | {descriptors.min():.0f}, "
              f"{descriptors.max():.0f} | {100 * share:.1f} % |")  # fmt: skip
    at = [int(np.searchsorted(minutes, minute)) for minute in range(0, int(minutes[-1]) + 1, 5)]
    steps = (f"{minutes[k]:.0f} min {rows[k, 1]:.1f} and {rows[k, 4]:.1f}" for k in at)
    print(f"\nMemory MB of daemon and SLAM process: {'; '.join(steps)}")
    print("\n| poses' period ms | median | p99 | max |\n|---|--:|--:|--:|")
    for name, times in (
        ("when they came", poses.arrived_s),
        ("when they were made", poses.made_s),
        ("their wheel frames", poses.wheels_s),
    ):
        gaps = 1e3 * np.diff(times)
        median, p99 = np.quantile(gaps, (0.5, 0.99))
        print(f"| {name} | {median:.1f} | {p99:.1f} | {gaps.max():.1f} |")
    total = sum(poses.states.values())
    shares = (f"{state} {100 * count / total:.2f} %" for state, count in poses.states.items())
    print(f"\n{total} poses: {', '.join(shares)}")


def least(minutes: Array, memory_mb: Array) -> tuple[Array, Array]:
    """Whole minutes in h, and the least of each in MB."""
    whole = np.floor(minutes)
    known = np.unique(whole)
    return known / 60.0, np.array([memory_mb[whole == minute].min() for minute in known])


def until(listener: FleetListener, condition: Callable[[PoseMessage], bool]) -> None:
    """Wait for a pose. Raises TrialError."""
    if not listener.wait_for(
        lambda views: any(v.pose is not None and condition(v.pose) for v in views.values()), _WAIT_S
    ):
        raise TrialError("no such pose came")


def free_endpoint() -> str:
    """A port of this computer that nobody uses."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


if __name__ == "__main__":
    sys.exit(main())
