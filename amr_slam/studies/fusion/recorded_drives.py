"""What a robot makes of a recording that is thinned to a scan every 2 s, and what its rivals do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.engine import SlamEngine
from amr_slam.fusion import Calibration, FilterParams
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import PoseOdometry
from amr_slam.params import SlamParams
from amr_slam.recording import Log, Sample, Trajectory
from amr_slam.replay import thin_scans
from amr_slam.samples import OdometrySample, Scan, SlamPose, State
from amr_slam.slam_request import SlamResult
from amr_slam.states import Mode
from amr_slam.studies.fusion.methods import (
    HELD,
    PRODUCT,
    UNDELAYED,
    WHEELS,
    held,
    undelayed,
    wheels_alone,
)
from amr_slam.studies.real_passes import Recording

_SCAN_PERIOD_S: Final = 2.0
_DELAY_NS: Final = 500_000_000
# A loop that moves the pose by less counts as any other correction.
_LOOP_M: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """What a robot made of a recording."""

    paths: dict[str, Trajectory]
    """Of each method: the pose at each wheel sample, as known then."""
    used_ns: NDArray[np.int64]
    """Stamps of the scans that were not skipped."""
    claimed_m: Array
    """error95_m at each wheel sample; NaN where the product did not call itself localized."""
    learned: Calibration
    loops_ns: NDArray[np.int64]
    """When a loop that was closed has moved the map under the robot."""


def in_known_map(name: str, log: Log, reference: Trajectory) -> Drive:
    """Localized from the first reference pose on, in a map of all scans at theirs."""
    params = SlamParams()
    known = PointMap(params.map)
    for visit in Recording.of(name, log, reference, params.clouds).visits:
        known.insert(visit.cloud, visit.pose)
    samples = [one for one in log.samples if one.stamp_ns >= reference.stamps_ns[0]]
    start = reference.pose(0), np.diag([0.05**2, 0.05**2, 0.01**2])
    return _drive(samples, SlamEngine(params, known, "localization"), "localization", start)


def from_scratch(log: Log) -> Drive:
    """Mapping as it goes, from the origin on."""
    params = SlamParams()
    start = Pose2.identity(), np.diag([1e-4, 1e-4, 1e-5])
    engine = SlamEngine(params, PointMap(params.map), "mapping")
    return _drive(log.samples, engine, "mapping", start)


def _drive(
    samples: Iterable[Sample], engine: SlamEngine, mode: Mode, start: tuple[Pose2, Array]
) -> Drive:
    thinned, odometry = list(thin_scans(samples, _SCAN_PERIOD_S)), PoseOdometry()
    scans = [sample for sample in thinned if isinstance(sample, Scan)]
    mountings = {one.scanner: Mounting(base_from_lidar=Pose2.identity()) for one in scans}
    robot = Localizer(
        LocalizerParams(), FilterParams(), SlamParams().clouds, odometry, mountings, mode, start
    )
    wheels: list[OdometrySample] = []
    product: list[Pose2] = []
    claimed_m: list[float] = []
    fixes: list[tuple[int, SlamPose]] = []
    waiting: list[tuple[int, SlamResult]] = []
    loops_ns: list[int] = []
    for sample in thinned:
        while waiting and waiting[0][0] <= sample.stamp_ns:
            arrived_ns, result = waiting.pop(0)
            before = None if robot.filter is None else robot.filter.map_from_base
            robot.handle(result)
            if result.moved is not None and before is not None and robot.filter is not None:
                moved_m = before.distance_to(robot.filter.map_from_base)
                loops_ns += [arrived_ns] if moved_m > _LOOP_M else []
        robot.handle(sample)
        if isinstance(sample, OdometrySample):
            estimate = robot.estimate(sample.stamp_ns)
            if estimate is not None and (not wheels or sample.stamp_ns > wheels[-1].stamp_ns):
                wheels.append(sample)
                product.append(estimate.map_from_base)
                good = estimate.state in {State.LOCALIZED, State.MAPPING}
                claimed_m.append(estimate.error95_m if good else math.nan)
        request = robot.take_request()
        if request is not None:
            result = engine.update(request)
            arrives_ns = result.stamp_ns + _DELAY_NS
            waiting.append((arrives_ns, result))
            fixes += [] if result.fix is None else [(arrives_ns, result.fix)]
    paths: dict[str, Sequence[Pose2]] = {
        PRODUCT: product,
        WHEELS: list(wheels_alone(wheels, odometry, start[0])),
        HELD: list(held(wheels, fixes, start[0])),
        UNDELAYED: list(undelayed(wheels, fixes, odometry, *start)),
    }
    stamps = np.array([sample.stamp_ns for sample in wheels], dtype=np.int64)
    assert robot.filter is not None
    return Drive(
        paths={
            name: Trajectory(stamps_ns=stamps, poses=np.array([p.as_array() for p in path]))
            for name, path in paths.items()
        },
        used_ns=np.array([scan.stamp_ns for scan in scans], dtype=np.int64),
        claimed_m=np.array(claimed_m),
        learned=robot.filter.calibration,
        loops_ns=np.array(loops_ns, dtype=np.int64),
    )
