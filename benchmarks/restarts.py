"""How long after ``kill -9`` a robot is localized again, and what a start costs.

The emulated robot of the demo stands in the laboratory that the daemon has mapped before; scanners
at 0.5 Hz. Processor time: of the daemon and of its SLAM process until the map is there.
Example: python benchmarks/restarts.py --kills 10
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import socket
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import psutil  # type: ignore[import-untyped]  # comes without types

from amr_drivers.emulators.robot import RobotModel, RobotProcess
from amr_slam.client import FleetListener
from amr_slam.states import State
from amr_slam.trial import DaemonProcess, TrialError, adapted_config
from amr_slam.wire import StatusMessage

REPO: Final = Path(__file__).resolve().parent.parent
ROBOT: Final = "demo"
_WAIT_S: Final = 120.0


def main() -> int:
    """Measure and print a Markdown table; 1 when a run was not localized where the last one was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=10)
    arguments = parser.parse_args()
    moments, rows = random.Random(1), []
    with tempfile.TemporaryDirectory() as scratch:
        out, endpoint = Path(scratch), free_endpoint()
        own = {"tcp/127.0.0.1:7447": endpoint, "out/demo": str(out), "config": str(REPO / "config")}
        config = adapted_config(REPO / "config/demo.toml", own, out / "robot.toml")
        with RobotProcess(out, str(REPO / "config/wheels.dbc"), RobotModel().seed) as robot:
            robot.drive(0.0, 0.3)
            started(config, out, endpoint, State.MAPPING, stand_s=25.0)
            robot.drive(0.0, 0.0)
            mode = f'mode = "localization"\npath = "{out}/demo.amrmap"'
            config.write_text(config.read_text("utf-8").replace('mode = "mapping"', mode), "utf-8")
            for _ in range(arguments.kills + 1):
                stand_s = 3.0 + moments.random()
                rows.append(started(config, out, endpoint, State.LOCALIZED, stand_s=stand_s))
    print("| | s, median | max |\n|---|--:|--:|")
    names = ("start to first status", "start to map", "start to localized", "processor time to map")
    for name, column in zip(names, list(zip(*rows[1:], strict=True)), strict=False):
        print(f"| {name} | {statistics.median(column):.1f} | {max(column):.1f} |")
    found = sum(row[4] for row in rows[1:])
    print(f"\n{found} of {arguments.kills} kills: localized where the last run left off")
    return 0 if found == arguments.kills else 1


def started(
    config: Path, out: Path, endpoint: str, state: State, stand_s: float
) -> tuple[float, float, float, float, bool]:
    """One run of the daemon: seconds to its first status, its map, ``state``; processor time until
    the map; whether the last pose helped. Then it is killed, or stopped where it has mapped."""
    log, begun_s = out / "daemon.log", time.monotonic()
    daemon = DaemonProcess(config, log)
    with daemon.listener(endpoint, ROBOT, _WAIT_S) as fleet:
        first_s = time.monotonic() - begun_s
        wait(fleet, lambda status: status.map is not None or status.slam.link == "OK")
        map_s = time.monotonic() - begun_s
        process = daemon.process
        times = [psutil.Process(process.pid), *psutil.Process(process.pid).children()]
        spent_s = sum(sum(one.cpu_times()[:2]) for one in times)
        wait(fleet, lambda status: status.state is state)
        state_s = time.monotonic() - begun_s
        time.sleep(stand_s)
    helped = "localized where the last run left off" in log.read_text("utf-8")
    if state is State.MAPPING:
        daemon.stop()
    else:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    return first_s, map_s, state_s, spent_s, helped


def wait(fleet: FleetListener, condition: Callable[[StatusMessage], bool]) -> None:
    """For a status; raises TrialError."""
    if not fleet.wait_for(
        lambda views: any(v.status is not None and condition(v.status) for v in views.values()),
        _WAIT_S,
    ):
        raise TrialError("the daemon did not come so far")


def free_endpoint() -> str:
    """A port of this computer that nobody uses."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


if __name__ == "__main__":
    sys.exit(main())
