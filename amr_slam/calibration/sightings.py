"""Where each scanner was: its scans found in a map that the drive itself makes.

The first pass maps with one scanner alone, so that a mounting that is wrongly told cannot double
a wall. The second finds every scan of every scanner in that map, each by its own points.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from amr_slam.calibration.values import Measures, Sightings
from amr_slam.clouds import cloud_from_scan
from amr_slam.engine import SlamEngine
from amr_slam.evaluation import poses_at
from amr_slam.fusion import FilterParams
from amr_slam.fusion.trail import Trail
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.recording import Trajectory
from amr_slam.replay import replay, thin_scans
from amr_slam.samples import Scan, WheelSample
from amr_slam.slam_request import SlamRequest

# How far a scan may be from where the first pass and the given mounting expect it (1 sigma): the
# mounting's error most of all.
_EXPECTED: Final = np.diag([0.1**2, 0.1**2, 0.06**2])


class CalibrationError(ValueError):
    """A recording that cannot be calibrated from: one line that says why and what to do."""


def find_sightings(
    samples: Sequence[Scan | WheelSample],
    measures: Measures,
    configured: Mapping[str, Mounting],
    params: SlamParams,
    scan_period_s: float,
    on_progress: Callable[[int], None] | None = None,
) -> Sightings:
    """Poses of all scanners in one map, which the first scanner makes.

    ``configured``: the mountings by scanner, for what is not measured (hanging, masks). Raises
    CalibrationError where too few scans are found.
    """
    names = [scanner.name for scanner in measures.scanners]
    drive = DifferentialDrive(
        radius_left_m=measures.radius_left_m,
        radius_right_m=measures.radius_right_m,
        track_m=measures.track_m,
    )
    lags_ns = {scanner.name: round(1e9 * scanner.lag_s) for scanner in measures.scanners}
    corrected = [
        replace(sample, stamp_ns=sample.stamp_ns - lags_ns[sample.scanner])
        if isinstance(sample, Scan)
        else sample
        for sample in samples
        if not isinstance(sample, Scan) or sample.scanner in lags_ns
    ]
    corrected.sort(key=lambda sample: (sample.stamp_ns, isinstance(sample, Scan)))
    thinned = [s for s in thin_scans(corrected, scan_period_s) if isinstance(s, Scan | WheelSample)]
    grown = PointMap(params.map, "calibration")
    mountings = {
        # The scans' stamps are corrected above, once.
        scanner.name: replace(
            configured[scanner.name], base_from_lidar=scanner.base_from_lidar, lag_s=0.0
        )
        for scanner in measures.scanners
    }
    path = _mapped(thinned, names[0], mountings, drive, params, grown, on_progress)
    rows: list[tuple[int, int, Array, Array]] = []
    engine = SlamEngine(params, grown, "localization")
    wheels = _wheels_alone(thinned, drive)
    for scan in (sample for sample in thinned if isinstance(sample, Scan)):
        found = _found(scan, path, wheels, mountings[scan.scanner], engine, params)
        if found is not None:
            raw_ns = scan.mid_stamp_ns + lags_ns[scan.scanner]
            rows.append((names.index(scan.scanner), raw_ns, *found))
        if on_progress is not None:
            on_progress(scan.stamp_ns)
    for number, name in enumerate(names):
        if sum(row[0] == number for row in rows) < 10:
            raise CalibrationError(
                f"scanner {name}: too few of its scans fit into the map: is its mounting right "
                "to 0.3 m and 20 degrees, upside_down included?"
            )
    return Sightings(
        scanner=np.array([row[0] for row in rows], dtype=np.int64),
        stamps_ns=np.array([row[1] for row in rows], dtype=np.int64),
        poses=np.array([row[2] for row in rows]),
        covariances=np.array([row[3] for row in rows]),
    )


def _mapped(
    samples: Sequence[Scan | WheelSample],
    scanner: str,
    mountings: Mapping[str, Mounting],
    drive: DifferentialDrive,
    params: SlamParams,
    grown: PointMap,
    on_progress: Callable[[int], None] | None,
) -> Trajectory:
    """The first pass: ``grown`` becomes the map; the base's way in it."""
    localizer = Localizer(
        LocalizerParams(),
        FilterParams(),
        params.clouds,
        drive,
        {scanner: mountings[scanner]},
        "mapping",
    )
    engine = SlamEngine(params, grown, "mapping")
    own = [s for s in samples if not isinstance(s, Scan) or s.scanner == scanner]
    result = replay(own, localizer, engine, on_progress)
    return result.final


def _wheels_alone(samples: Sequence[Scan | WheelSample], drive: DifferentialDrive) -> Trail:
    wheels = [sample for sample in samples if isinstance(sample, WheelSample)]
    trail = Trail(wheels[0].stamp_ns)
    for before, after in itertools.pairwise(wheels):
        trail.append(drive.motion(before, after))
    return trail


def _sweep(scan: Scan, wheels: Trail) -> tuple[Pose2, Pose2] | None:
    """The base at the first and last beam, in its frame of the middle instant; None outside the
    wheels' time."""
    end_ns = scan.stamp_ns + round(1e9 * scan.sweep_s)
    if scan.stamp_ns < wheels.start_ns or end_ns > wheels.end_ns:
        return None
    middle_ns = scan.mid_stamp_ns
    return wheels.between(middle_ns, scan.stamp_ns).delta, wheels.between(middle_ns, end_ns).delta


def _found(
    scan: Scan,
    path: Trajectory,
    wheels: Trail,
    mounting: Mounting,
    engine: SlamEngine,
    params: SlamParams,
) -> tuple[Array, Array] | None:
    """(map_from_lidar (3,), covariance (3, 3)) of a scan that is found in the map."""
    poses, known = poses_at(path, np.array([scan.mid_stamp_ns]))
    sweep = _sweep(scan, wheels)
    if not known[0] or sweep is None:
        return None
    cloud = cloud_from_scan(
        scan, mounting.base_from_lidar, params.clouds, upside_down=mounting.upside_down, sweep=sweep
    )
    fix = engine.update(
        SlamRequest(cloud=cloud, map_from_base=Pose2.from_array(poses[0]), covariance=_EXPECTED)
    ).fix
    if fix is None or fix.relocalized:
        return None
    base = fix.map_from_base
    lidar = base @ mounting.base_from_lidar
    by_base = np.eye(3)
    by_base[:2, 2] = -(lidar.y_m - base.y_m), lidar.x_m - base.x_m
    return lidar.as_array(), by_base @ fix.covariance @ by_base.T
