"""The whole way without hardware: an emulated robot, the daemon, and a consumer of its poses.

Scanners and wheels are reached through the real drivers; the robot is steered round its tour by
nothing but the poses that arrive over Zenoh. Status 1 if it was ever wrong without saying so.

Example: python tools/demo.py --seconds 60
"""

from __future__ import annotations

import argparse
import json
import signal
import socket
import sys
from dataclasses import asdict
from math import degrees
from pathlib import Path

import numpy as np

from amr_drivers.emulators.robot import RobotModel, RobotProcess
from amr_drivers.errors import DriverError
from amr_slam.judging import ReportedPose, Verdict, judge
from amr_slam.map import MapError, load_map
from amr_slam.pictures import draw_map
from amr_slam.simulation import DRIVABLE, CautiousPilot
from amr_slam.trial import DaemonProcess, TrialError, adapted_config, drive

REPO = Path(__file__).resolve().parent.parent


def main() -> int:
    """Parse, run, and turn failures into one line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to drive")
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="ports and results")
    arguments = parser.parse_args()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    try:
        return run(arguments.seconds, arguments.out.absolute())
    except (DriverError, TrialError, MapError, OSError, ValueError) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def run(seconds: float, out: Path) -> int:
    """Start everything, drive, stop everything, judge; the exit status."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "demo.lastpose").unlink(missing_ok=True)  # a demo that was killed is not gone on with
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    # A folder and a port of its own: demos can run side by side.
    own = {"tcp/127.0.0.1:7447": endpoint, "out/demo": str(out), "config": str(REPO / "config")}
    config = adapted_config(REPO / "config/demo.toml", own, out / "demo.toml")
    model = RobotModel()
    pilot = CautiousPilot(model.tour().path_in_map_m)
    reports: list[ReportedPose] = []
    with RobotProcess(out, str(REPO / "config/wheels.dbc"), model.seed) as robot:
        with (
            DaemonProcess(config, out / "daemon.log") as daemon,
            daemon.listener(endpoint, "demo") as listener,
        ):
            print(f"driving for {seconds:g} s by the poses at {endpoint}, key amr/demo/pose")
            for report in drive(daemon, listener, pilot, robot.drive, seconds):
                reports.append(report)
                if len(reports) % 50 == 0:
                    print(_line(report, judge(reports[-50:], robot.truth())), flush=True)
        truth, paused_s = robot.truth(), robot.paused_s()
    verdict = judge(reports, truth)
    print(f"\n{verdict.text()}")
    if paused_s > 0.0:
        print(f"(this computer was busy: the robot's world stood still for {paused_s:.2f} s)")
    results = asdict(verdict) | {"world_paused_s": paused_s}
    (out / "summary.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    fused = np.array([r.map_from_base.translation for r in reports if r.state in DRIVABLE])
    paths = [("fused", fused.reshape(-1, 2)), ("truth", truth.poses[:, :2])]
    known, _ = load_map(out / "demo.amrmap")
    draw_map(known, paths, out / "map.png", f"{known.area_m2():.0f} m² mapped by the demo")
    print(f"picture: {out / 'map.png'}")
    return 0 if verdict.is_trustworthy else 1


def _line(report: ReportedPose, second: Verdict) -> str:
    pose = report.map_from_base
    error = "" if second.position_m is None else f", really {second.position_m.max:.3f} m off"
    return (
        f"x {pose.x_m:7.3f} m  y {pose.y_m:7.3f} m  heading {degrees(pose.theta_rad):7.2f} deg  "
        f"{report.state.value} within {report.error95_m:.3f} m{error}"
    )


if __name__ == "__main__":
    sys.exit(main())
