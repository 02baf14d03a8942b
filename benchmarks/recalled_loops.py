"""Loops after a long way in a real building: the scans of a log, its reference, and added drift.

The chart alone, without registration: each step is that of the reference with errors of 0.004 rad
for the root of a metre, 0.4 % of scale and 1 cm. Prints each correction above half a metre, and in
the end how many closures are off by more than a metre from the reference.

Example: python benchmarks/recalled_loops.py mit_killian --nodes 800
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan
from amr_slam.geometry import Pose2
from amr_slam.graph.chart import Chart
from amr_slam.params import SlamParams
from amr_slam.recording import read_log, read_tum
from amr_slam.samples import Scan
from amr_slam.studies.large import ate_m

REPO: Final = Path(__file__).resolve().parent.parent
LOGS: Final = Path(os.environ.get("AMR_SLAM_SHARED", REPO.parent / "shared")) / "data/logs"
STEP: Final = np.diag([0.02**2, 0.02**2, 0.006**2])


def main() -> int:
    """Parse, drive, sum up."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", help="name without its endings")
    parser.add_argument("--nodes", type=int, default=100_000, help="no more than so many")
    arguments = parser.parse_args()
    clouds, truth = scans_at_reference(arguments.log, arguments.nodes)
    chart, rng = Chart(SlamParams()), np.random.default_rng(0)
    drifted = [truth[0]]
    for row, (cloud, true) in enumerate(zip(clouds, truth, strict=True)):
        pose = truth[0]
        if row:
            step = drifting(truth[row - 1].inverse() @ true, rng)
            drifted.append(drifted[-1] @ step)
            pose = chart.newest @ step
        chart.insert(cloud, pose, STEP)
        if row and chart.newest.distance_to(pose) > 0.5:
            print(f"node {row}: moved by {chart.newest.distance_to(pose):.2f} m", flush=True)
    loops = [edge for edge in chart.edges if edge.loop]
    off = [(truth[e.start].inverse() @ truth[e.end]).inverse() @ e.delta for e in loops]
    false = sum(math.hypot(one.x_m, one.y_m) > 1.0 for one in off)
    rows = np.array([pose.as_array() for pose in truth])
    before = ate_m(np.array([pose.as_array() for pose in drifted]), rows)
    print(
        f"{len(truth)} nodes, {len(loops)} closures, {false} off by more than 1 m, "
        f"ATE {before:.2f} m without and {ate_m(chart.poses, rows):.2f} m with loops"
    )
    return 0


def scans_at_reference(log: str, most: int) -> tuple[list[Cloud], list[Pose2]]:
    """Scans within 50 ms of the reference's stamps, 0.4 m or 0.3 rad apart, with its poses."""
    reference = read_tum(LOGS / f"{log}.corrected.tum")
    samples = read_log(LOGS / f"{log}.log.gz").samples
    scans = [sample for sample in samples if isinstance(sample, Scan)]
    stamps = np.array([scan.stamp_ns for scan in scans])
    clouds: list[Cloud] = []
    truth: list[Pose2] = []
    for stamp_ns, row in zip(reference.stamps_ns, reference.poses, strict=True):
        pose, nearest = Pose2.from_array(row), int(np.argmin(np.abs(stamps - stamp_ns)))
        if abs(int(stamps[nearest] - stamp_ns)) > 50_000_000 or len(truth) == most:
            continue
        step = truth[-1].inverse() @ pose if truth else Pose2(1.0, 0.0, 0.0)
        if math.hypot(step.x_m, step.y_m) < 0.4 and abs(step.theta_rad) < 0.3:
            continue
        clouds.append(cloud_from_scan(scans[nearest], Pose2.identity(), CloudParams()))
        truth.append(pose)
    return clouds, truth


def drifting(step: Pose2, rng: np.random.Generator) -> Pose2:
    """The step as it might be measured."""
    length_m = max(math.hypot(step.x_m, step.y_m), 0.05)
    return Pose2(
        1.004 * step.x_m + rng.normal(0.0, 0.01),
        step.y_m + rng.normal(0.0, 0.01),
        step.theta_rad + rng.normal(0.0, 0.004 * math.sqrt(length_m)),
    )


if __name__ == "__main__":
    sys.exit(main())
