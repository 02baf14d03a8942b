"""Drive a simulated robot round a seeded laboratory and record what its devices measure.

Example: python tools/simulate.py --seed 7 --noise-xy 0.1 --out run.mcap --truth run.tum
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from amr_slam.recording import RecordingWriter, Trajectory, write_tum
from amr_slam.samples import Scan
from amr_slam.simulation import (
    CeilingCameras,
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Vehicle,
    laboratory,
    opposite_scanners,
    plan_tour,
)


def main() -> int:
    """Parse, drive the tour by the truth, write the recording and where the robot really was."""
    arguments = _parser().parse_args()
    world = laboratory(arguments.seed)
    tour = plan_tour(world)
    model = ScannerModel(sigma_xy_m=arguments.noise_xy, sigma_range_m=arguments.noise_range)
    scanners = opposite_scanners(model) if arguments.scanners == 2 else (model,)
    errors = np.random.default_rng(arguments.seed).normal(0.0, arguments.odometry_error, 3)
    robot = SimulatedRobot(
        world=world,
        world_from_map=tour.world_from_map,
        scanners=scanners,
        vehicle=Vehicle(
            left_radius_error=errors[0], right_radius_error=errors[1], track_error=errors[2]
        ),
        people=arguments.people,
        scan_period_s=arguments.scan_period,
        seed=arguments.seed,
    )
    follower = PathFollower(tour.path_in_map_m)
    stamps, poses = [robot.stamp_ns], [robot.map_from_base]
    scans = 0
    mountings = {scanner.name: scanner.base_from_lidar for scanner in scanners}
    with RecordingWriter(arguments.out, mountings) as writer:
        while _goes_on(robot, follower, arguments.duration):
            for sample in robot.advance(*follower.steer(robot.map_from_base)):
                writer.write(sample)
                scans += isinstance(sample, Scan)
            stamps.append(robot.stamp_ns)
            poses.append(robot.map_from_base)
        for stamp_ns, pose in zip(stamps, poses, strict=True):
            writer.write_truth(stamp_ns, pose)
    truth = Trajectory(
        stamps_ns=np.array(stamps, dtype=np.int64),
        poses=np.array([pose.as_array() for pose in poses]),
    )
    if arguments.truth is not None:
        write_tum(arguments.truth, truth)
    if arguments.cameras is not None:
        seen, _ = CeilingCameras().watch(truth, np.random.default_rng(arguments.seed))
        write_tum(arguments.cameras, seen)
    print(f"{arguments.out}: {1e-9 * robot.stamp_ns:.1f} s, {scans} scans, {robot.bumps} bumps")
    return 0


def _goes_on(robot: SimulatedRobot, follower: PathFollower, duration_s: float | None) -> bool:
    return follower.laps < 1.0 if duration_s is None else robot.stamp_ns < 1e9 * duration_s


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--seed", type=int, default=0, help="of the world and all noise")
    add("--out", type=Path, required=True, help="the recording (.mcap)")
    add("--truth", type=Path, help="the true trajectory (TUM), start pose at the origin")
    add("--cameras", type=Path, help="what ceiling cameras see of it, in a frame of theirs (TUM)")
    add("--duration", type=float, help="seconds; without it, once round the tour")
    add("--scanners", type=int, choices=(1, 2), default=2, help="2: at opposite corners")
    add("--scan-period", type=float, default=2.0, help="seconds between scans of one scanner")
    add("--noise-xy", type=float, default=0.0, help="m, sigma in both x and y of each point")
    add("--noise-range", type=float, default=0.01, help="m, sigma along the beam")
    add("--odometry-error", type=float, default=0.0, help="sigma of wheel radii and track, share")
    add("--people", type=int, default=0, help="people walking about")
    return parser


if __name__ == "__main__":
    sys.exit(main())
