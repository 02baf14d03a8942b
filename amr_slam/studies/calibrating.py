"""Calibration of simulated robots that are built otherwise than they are configured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.calibration import Calibration, Measures, ScannerMeasures, calibrate
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.localizer import Mounting
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Vehicle,
    laboratory,
    opposite_scanners,
    plan_tour,
)
from amr_slam.studies.report import Effort, Section, Table

CONFIGURED: Final = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
"""What the robots' data sheet says."""

_ROBOTS: Final = 20
_DURATION_S: Final = 300.0
# Largest errors of the robots, uniform: shares of radii and track, then m, rad and s.
_SHARE, _PLACE_M, _ANGLE_RAD, _LAG_S = 0.05, 0.05, math.radians(3.0), 0.15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BuiltRobot:
    """A recorded drive of a robot, and how it is really built."""

    samples: tuple[Scan | WheelSample, ...]
    mountings: dict[str, Mounting]
    """As configured."""
    truth: Measures


def drive(seed: int, duration_s: float, scan_period_s: float) -> BuiltRobot:
    """A robot of two S300s, wrong in everything, driven round a laboratory."""
    rng = np.random.default_rng(seed)
    left, right, track = rng.uniform(-_SHARE, _SHARE, 3)
    configured = opposite_scanners(ScannerModel(sigma_range_m=0.01))
    scanners: list[ScannerModel] = []
    measures: list[ScannerMeasures] = []
    for model in configured:
        off = [*rng.uniform(-_PLACE_M, _PLACE_M, 2), rng.uniform(-_ANGLE_RAD, _ANGLE_RAD)]
        built = Pose2.from_array(model.base_from_lidar.as_array() + off)
        scanners.append(replace(model, base_from_lidar=built))
        lag_s = float(rng.uniform(0.0, _LAG_S))
        measures.append(ScannerMeasures(name=model.name, base_from_lidar=built, lag_s=lag_s))
    world = laboratory(seed)
    tour = plan_tour(world)
    robot = SimulatedRobot(
        world=world,
        world_from_map=tour.world_from_map,
        scanners=scanners,
        vehicle=Vehicle(left_radius_error=left, right_radius_error=right, track_error=track),
        scan_period_s=scan_period_s,
        seed=seed,
    )
    follower = PathFollower(tour.path_in_map_m)
    lags_ns = {one.name: round(1e9 * one.lag_s) for one in measures}
    samples: list[Scan | WheelSample] = []
    while robot.stamp_ns < 1e9 * duration_s:
        for sample in robot.advance(*follower.steer(robot.map_from_base)):
            if isinstance(sample, Scan):
                late_ns = sample.stamp_ns + lags_ns[sample.scanner]
                samples.append(replace(sample, stamp_ns=late_ns))
            else:
                samples.append(sample)
    samples.sort(key=lambda sample: (sample.stamp_ns, isinstance(sample, Scan)))
    return BuiltRobot(
        samples=tuple(samples),
        mountings={m.name: Mounting(base_from_lidar=m.base_from_lidar) for m in configured},
        truth=Measures(
            radius_left_m=CONFIGURED.radius_left_m * (1.0 + left),
            radius_right_m=CONFIGURED.radius_right_m * (1.0 + right),
            track_m=CONFIGURED.track_m * (1.0 + track),
            scanners=tuple(measures),
        ),
    )


def errors(found: Calibration, truth: Measures) -> Array:
    """(k,) of ``found.measures.as_array()``."""
    error = found.measures.as_array() - truth.as_array()
    error[5::4] = wrap_angle(error[5::4])
    return error


def run(effort: Effort) -> Section:
    """Twenty robots, five minutes each."""
    rows: list[tuple[str, ...]] = []
    for scan_period_s in (0.5, 2.0):
        found: list[Array] = []
        bounds: list[Array] = []
        for robot in range(effort.trials(_ROBOTS)):
            effort.progress(f"calibration: robot {robot}, a scan in {scan_period_s:g} s")
            built = drive(effort.seed + robot, _DURATION_S, scan_period_s)
            calibration = calibrate(
                built.samples,
                CONFIGURED,
                built.mountings,
                SlamParams(),
                scan_period_s=scan_period_s,
            )
            found.append(errors(calibration, built.truth))
            bounds.append(calibration.sigmas)
        rows += _rows(f"{scan_period_s:g} s", np.array(found), np.array(bounds))
    return Section(
        title="Calibration from a drive",
        text=(
            f"{effort.trials(_ROBOTS)} simulated robots with two S300s (1 cm noise, 1 cm steps), "
            f"driven for {_DURATION_S / 60:g} minutes round a laboratory; wheel radii and track "
            f"wrong by up to {_SHARE:.0%}, mountings by up to {100 * _PLACE_M:g} cm and "
            f"{math.degrees(_ANGLE_RAD):g} degrees, clocks by up to {_LAG_S:g} s (uniform); slip "
            "of 1 mm in 1 m on each wheel. The bound is what calibration itself says of its "
            "uncertainty: the inverse information of all that was recorded, at noise levels of "
            "the greatest restricted likelihood."
        ),
        tables=(
            Table(
                title="Errors of the measures found",
                columns=("a scan in", "measure", "wanted", "rms", "worst", "rms of error / bound"),
                rows=tuple(rows),
            ),
        ),
    )


def _rows(period: str, found: Array, bounds: Array) -> list[tuple[str, ...]]:
    """``found`` and ``bounds``: (robots, k)."""
    radius = 100.0 / CONFIGURED.radius_left_m
    track = 100.0 / CONFIGURED.track_m
    scanners = np.arange(3, found.shape[1], 4)
    groups = (
        ("wheel radii", "%", radius, np.array([0, 1]), "0.1 %"),
        ("track", "%", track, np.array([2]), "0.3 %"),
        ("mounting x, y", "mm", 1e3, np.concatenate([scanners, scanners + 1]), "5 mm"),
        ("mounting angle", "deg", math.degrees(1.0), scanners + 2, "0.1 deg"),
        ("clock lag", "ms", 1e3, scanners + 3, ""),
    )
    rows: list[tuple[str, ...]] = []
    for name, unit, scale, columns, wanted in groups:
        error = scale * found[:, columns]
        ratio = found[:, columns] / bounds[:, columns]
        rows.append(
            (
                period,
                name,
                wanted,
                f"{np.sqrt(np.mean(error**2)):.3f} {unit}",
                f"{np.abs(error).max():.3f} {unit}",
                f"{np.sqrt(np.mean(ratio**2)):.2f}",
            )
        )
    return rows
