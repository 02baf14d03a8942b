"""How old the newest wheel sample is when a pose goes out, while the SLAM process searches a map.

The emulated robot of the demo (CAN frames over a pseudo-terminal, scanners at 0.5 Hz) and the
daemon in its own process. In one run it maps the laboratory; in the other it is given the map of
another place, so that each scan is searched for everywhere and never found. ``age_s`` in each pose
is the time from the wheel frame's arrival to the estimate; encoding and Zenoh's ``put`` follow it
and are measured here by themselves. Example: python benchmarks/latency.py --seconds 40
"""

from __future__ import annotations

import argparse
import socket
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np

from amr_drivers.emulators.robot import RobotModel, RobotProcess
from amr_slam.client import FleetListener
from amr_slam.clouds import cloud_from_scan
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.map.file import save_map
from amr_slam.params import SlamParams
from amr_slam.publishing import RobotPublisher
from amr_slam.simulation import ScannerModel, plan_tour, take_scan
from amr_slam.simulation.halls import hall
from amr_slam.trial import DaemonProcess, adapted_config
from amr_slam.wire import PoseMessage, ZenohSettings

REPO: Final = Path(__file__).resolve().parent.parent
SCANNER: Final = ScannerModel(sigma_range_m=0.01)
AREA_M2: Final = 2000.0
_PUTS: Final = 2000


def main() -> int:
    """Measure and print a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=40.0, help="of each run")
    arguments = parser.parse_args()
    print(
        "| SLAM process | poses | wheel frame to estimate ms, median / p99 / max |\n|---|--:|--:|"
    )
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        pose = None
        for busy in (False, True):
            messages = poses(out, arguments.seconds, searching=busy)
            ages = 1e3 * np.array([message.age_s for message in messages])
            what = f"searches a map of {AREA_M2:.0f} m2 for each scan" if busy else "maps"
            median, p99 = np.quantile(ages, (0.5, 0.99))
            print(f"| {what} | {len(ages)} | {median:.2f} / {p99:.2f} / {ages.max():.2f} |")
            pose = messages[-1]
    if pose is not None:
        print(f"\nencode and put of one pose: {put_us(pose)}")
    return 0


def poses(out: Path, seconds: float, *, searching: bool) -> list[PoseMessage]:
    """What the daemon publishes while the robot drives a circle, at home or lost."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    own = {"tcp/127.0.0.1:7447": endpoint, "out/demo": str(out), "config": str(REPO / "config")}
    config = adapted_config(REPO / "config/demo.toml", own, out / "latency.toml")
    if searching:
        path = out / "elsewhere.amrmap"
        save_map(elsewhere(), path)
        text = config.read_text("utf-8")
        config.write_text(
            text.replace('mode = "mapping"', f'mode = "localization"\npath = "{path}"'), "utf-8"
        )
    model = RobotModel()
    found: list[PoseMessage] = []
    with (
        RobotProcess(out, str(REPO / "config/wheels.dbc"), model.seed) as robot,
        DaemonProcess(config, out / "daemon.log") as daemon,
        daemon.listener(endpoint, "demo") as listener,
    ):
        until(listener)
        robot.drive(0.1, 0.3)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            message = listener.next_pose(0.5)
            if message is None:
                daemon.check()
            else:
                found.append(message)
        robot.drive(0.0, 0.0)
    return found


def until(listener: FleetListener, timeout_s: float = 60.0) -> None:
    """Wait for the first registration; raises TimeoutError."""
    if not listener.wait_for(
        lambda views: any(
            view.status is not None and any(name.startswith("fix") for name in view.status.outcomes)
            for view in views.values()
        ),
        timeout_s,
    ):
        raise TimeoutError("no scan was registered")


def elsewhere() -> PointMap:
    """A hall, mapped from true poses."""
    world = hall(3, AREA_M2)
    params = SlamParams()
    grown, rng = PointMap(params.map), np.random.default_rng(0)
    for position in plan_tour(world).path_m[::24]:
        pose = Pose2.from_array((*position, rng.uniform(-np.pi, np.pi)))
        scan = take_scan(SCANNER, world, pose, rng)
        grown.insert(cloud_from_scan(scan, Pose2.identity(), params.clouds), pose)
    return grown


def put_us(message: PoseMessage) -> str:
    """Median and p99 of encoding and putting a pose, with a subscriber connected."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    took_s = []
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), message.robot) as publisher,
        FleetListener(endpoint, [message.robot]),
    ):
        for _ in range(_PUTS):
            begun_s = time.perf_counter()
            publisher.publish_pose(message)
            took_s.append(time.perf_counter() - begun_s)
    median, p99 = 1e6 * np.quantile(took_s, (0.5, 0.99))
    return f"median {median:.0f} us, p99 {p99:.0f} us"


if __name__ == "__main__":
    sys.exit(main())
