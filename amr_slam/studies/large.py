"""Loops in a large warehouse whose aisles look alike, and what a scan costs as the map grows."""

from __future__ import annotations

import math
import resource
import time
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan
from amr_slam.engine import SlamEngine
from amr_slam.evaluation import align_se2
from amr_slam.geometry import Array, Pose2, inverse_matrix, wrap_angle
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.pictures import style
from amr_slam.simulation import ScannerModel, World, take_scan
from amr_slam.simulation.aisles import Warehouse, warehouse
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.studies.report import Effort, Picture, Section, Table

_AREA_M2: Final = 10_000.0
_LEAST_AREA_M2: Final = 2_500.0
_SEEDS: Final = 20
_SCANS: Final = 3600
"""Two hours at 0.5 Hz."""
_STEP_M: Final = 1.0
_FALSE_M, _FALSE_RAD = 0.5, 0.1
"""A closure that is off by more is false."""
# Wheels: one scale and one bend of each robot, and noise of each step of a metre.
_SCALE, _BEND_RADPM = 0.005, 0.003
_NOISE: Final = np.array([0.01, 0.01, 0.005])
_BELIEVED: Final = np.diag([0.03**2, 0.03**2, 0.02**2])
"""Covariance of a step, as the engine is told."""
_SIGHT_M: Final = 31.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mapped:
    """One drive, mapped."""

    seed: int
    truth: Array
    """(n, 3) in the world, of the scans that joined the map."""
    poses: Array
    """(n, 3) map_from_base of these."""
    wheels: Array
    """(n, 3) by the wheels alone."""
    way_m: float
    refused: int
    """Scans without a fix."""
    loops: int
    false: int
    longest_m: float
    """Way between the two ends of a loop that is farthest round."""
    times_s: Array
    """(m,) processor time of each scan."""
    sizes_mb: tuple[float, float]
    """Memory of the process half way and in the end."""

    def cells(self) -> tuple[str, ...]:
        quarter = len(self.times_s) // 4
        mean_ms = [1e3 * float(np.mean(part)) for part in np.split(self.times_s[: 4 * quarter], 4)]
        return (
            str(self.seed),
            f"{self.way_m:.0f}",
            f"{len(self.poses)}",
            f"{self.refused}",
            f"{self.loops}",
            f"{self.false}",
            f"{ate_m(self.wheels, self.truth):.1f}",
            f"{ate_m(self.poses, self.truth):.3f}",
            " / ".join(f"{mean:.0f}" for mean in mean_ms),
            f"{1e3 * float(np.quantile(self.times_s, 0.99)):.0f}",
            f"{1e3 * float(self.times_s.max()):.0f}",
            " / ".join(f"{size:.0f}" for size in self.sizes_mb),
        )


_COLUMNS: Final = (
    "seed",
    "way m",
    "scans joined",
    "without fix",
    "closures",
    "false closures",
    "ATE m, wheels",
    "ATE m, map",
    "ms a scan, by quarter of the drive",
    "p99 ms",
    "most ms",
    "MB half way / end",
)


def run(effort: Effort) -> Section:
    """One warehouse and one drive a seed."""
    seeds = effort.trials(_SEEDS)
    # Where not even one whole drive is wanted: part of a drive, in a smaller hall.
    part = min(1.0, effort.scale * _SEEDS)
    scans, area_m2 = round(part * _SCANS), max(part * _AREA_M2, _LEAST_AREA_M2)
    mapped: list[Mapped] = []
    for number in range(seeds):
        effort.progress(f"large: warehouse {number + 1} of {seeds}")
        mapped.append(drive(warehouse(effort.seed + number, area_m2), scans, SlamParams()))
        effort.progress("  " + " | ".join(mapped[-1].cells()))
    false = sum(one.false for one in mapped)
    return Section(
        title=f"A warehouse of {area_m2:.0f} m2 in which every aisle looks like the next",
        text=(
            f"{seeds} seeds, {scans / 1800.0:.1f} hours each: a scan of one S300 in 2 s and 1 m, "
            f"mapped from nothing by the engine with simulated wheels. In every block of racks the "
            f"same bays are filled, but for one in ten. A closure is false where it is off by "
            f"more than {_FALSE_M} m or "
            f"{math.degrees(_FALSE_RAD):.0f} degrees from the truth: {false} of "
            f"{sum(one.loops for one in mapped)} were. Times are processor time; the most "
            f"expensive scans are those at which a loop moves all nodes."
        ),
        tables=(
            Table(title="Drives", columns=_COLUMNS, rows=tuple(one.cells() for one in mapped)),
        ),
        pictures=(_figure(mapped[0], warehouse(mapped[0].seed, area_m2).world),),
    )


def drive(hall: Warehouse, scans: int, params: SlamParams) -> Mapped:
    """So many scans in a warehouse."""
    rng = np.random.default_rng((hall.world.seed, 41))
    truth = hall.drive(rng, scans, _STEP_M)
    scale, bend = rng.normal(0.0, [_SCALE, _BEND_RADPM])
    engine = SlamEngine(params, PointMap(params.map), "mapping")
    pose, covariance = Pose2.identity(), 1e-6 * np.eye(3)
    wheels, times, joined, halfway = Pose2.identity(), [], [], 0.0
    by_wheels: list[Array] = []
    refused = 0
    for number, true in enumerate(truth):
        if number:
            step = _measured(truth[number - 1].inverse() @ true, scale, bend, rng)
            pose, wheels = pose @ step, wheels @ step
            covariance = covariance + _BELIEVED
        cloud = _seen(hall.world, true, rng, number)
        begun_s = time.process_time()
        result = engine.update(SlamRequest(cloud=cloud, map_from_base=pose, covariance=covariance))
        times.append(time.process_time() - begun_s)
        if result.inserted:
            joined.append(number)
            by_wheels.append(wheels.as_array())
        refused += result.fix is None and number > 0
        pose, covariance = _corrected(pose, covariance, result)
        if number == scans // 2:
            halfway = _size_mb()
    chart = engine.chart
    assert chart is not None
    true_poses = np.array([truth[number].as_array() for number in joined])
    ways = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(true_poses[:, :2], axis=0).T))])
    loops = [edge for edge in chart.edges if edge.loop]
    off = [_off(true_poses, edge.start, edge.end, edge.delta) for edge in loops]
    return Mapped(
        seed=hall.world.seed,
        truth=true_poses,
        poses=chart.poses,
        wheels=np.array(by_wheels),
        way_m=float(ways[-1]),
        refused=refused,
        loops=len(loops),
        false=sum(m > _FALSE_M or rad > _FALSE_RAD for m, rad in off),
        longest_m=max((ways[edge.end] - ways[edge.start] for edge in loops), default=0.0),
        times_s=np.array(times),
        sizes_mb=(halfway, _size_mb()),
    )


def ate_m(poses: Array, truth: Array) -> float:
    """Root mean square distance once the two are aligned."""
    off = (align_se2(poses, truth) @ poses[:, :2]) - truth[:, :2]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _measured(step: Pose2, scale: float, bend: float, rng: np.random.Generator) -> Pose2:
    """The step as the wheels tell it."""
    length = math.hypot(step.x_m, step.y_m)
    noise = rng.normal(0.0, 1.0, 3) * _NOISE
    return Pose2(
        step.x_m * (1.0 + scale) + noise[0],
        step.y_m + noise[1],
        step.theta_rad * (1.0 + scale) + bend * length + noise[2],
    )


def _seen(world: World, pose: Pose2, rng: np.random.Generator, number: int) -> Cloud:
    model = ScannerModel(sigma_range_m=0.01, sweep_s=0.0)
    ends = world.segments_m.reshape(-1, 2, 2) - pose.translation
    near = np.any(np.abs(ends).max(axis=2) < _SIGHT_M, axis=1)
    long = np.abs(ends[:, 0] - ends[:, 1]).max(axis=1) > _SIGHT_M
    about = replace(world, segments_m=world.segments_m[near | long])
    scan = take_scan(model, about, pose, rng, stamp_ns=number * 2_000_000_000)
    return cloud_from_scan(scan, model.base_from_lidar, CloudParams())


def _corrected(pose: Pose2, covariance: Array, result: SlamResult) -> tuple[Pose2, Array]:
    """The expected pose with what the scan says of it."""
    if result.fix is not None:
        off = result.fix.map_from_base.as_array() - pose.as_array()
        off[2] = wrap_angle(float(off[2]))
        gain = covariance @ inverse_matrix(covariance + result.fix.covariance)
        pose = Pose2.from_array(pose.as_array() + gain @ off)
        covariance = (np.eye(3) - gain) @ covariance + 1e-6 * np.eye(3)
    if result.moved is not None:
        pose = result.moved @ pose
    return pose, 0.5 * (covariance + covariance.T)


def _off(truth: Array, start: int, end: int, delta: Pose2) -> tuple[float, float]:
    """(m, rad) that a closure is off by."""
    true = Pose2.from_array(truth[start]).inverse() @ Pose2.from_array(truth[end])
    off = true.inverse() @ delta
    return math.hypot(off.x_m, off.y_m), abs(off.theta_rad)


def _size_mb() -> float:
    """Most memory that the process has had so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _figure(mapped: Mapped, world: World) -> Picture:
    figure = style.sheet(11.0, 5.0)
    left, right = figure.subplots(1, 2)
    corners = world.segments_m.reshape(-1, 2)
    style.ground(left, corners.min(axis=0) - 1.0, corners.max(axis=0) + 1.0)
    for x1, y1, x2, y2 in world.segments_m:
        left.plot([x1, x2], [y1, y2], color=style.GREY, linewidth=0.4)
    aligned = align_se2(mapped.poses, mapped.truth) @ mapped.poses[:, :2]
    wheels = align_se2(mapped.wheels, mapped.truth) @ mapped.wheels[:, :2]
    left.plot(*wheels.T, color=style.VERMILION, linewidth=0.5, label="wheels alone")
    left.plot(*mapped.truth[:, :2].T, color=style.GREEN, linewidth=1.6, label="truth")
    left.plot(*aligned.T, color=style.BLUE, linewidth=0.7, label=f"map, seed {mapped.seed}")
    left.set_aspect("equal")
    style.legend_above(left)
    smooth = np.convolve(1e3 * mapped.times_s, np.full(50, 0.02), mode="valid")
    right.plot(1e3 * mapped.times_s, ".", markersize=1.5, color=style.GREY, label="each scan")
    right.plot(np.arange(len(smooth)) + 25, smooth, color=style.BLUE, label="mean of 50")
    right.set_yscale("log")
    style.chart(right, x="scan", y="processor time, ms", legend="best")
    return Picture(
        name="large-warehouse",
        caption="The first seed: the way by the map over the truth, and the time of each scan.",
        figure=figure,
    )
