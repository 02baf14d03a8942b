"""The pose between scans on recordings of real robots, against references at the skipped scans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.engine import SlamEngine, SlamResult
from amr_slam.evaluation import ErrorSummary, align_se2, poses_at
from amr_slam.fusion import Calibration, FilterParams
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import PoseOdometry
from amr_slam.params import SlamParams
from amr_slam.recording import Trajectory, read_log, read_tum
from amr_slam.replay import thin_scans
from amr_slam.samples import OdometrySample, Scan, SlamPose
from amr_slam.studies.fusion.methods import (
    HELD,
    METHODS,
    PRODUCT,
    UNDELAYED,
    WHEELS,
    held,
    undelayed,
    wheels_alone,
)
from amr_slam.studies.report import Effort, Section, Table

LOGS: Final = ("mit_csail", "intel")
_SCAN_PERIOD_S: Final = 2.0
_DELAY_NS: Final = 500_000_000
_WINDOW_NS: Final = 20_000_000_000
_GAP_S: Final = 2.0
# As near to a used scan, a reference tells nothing about the time between scans.
_USED_NS: Final = 50_000_000
_LEAST: Final = 5


def study(effort: Effort, logs: Path) -> Section:
    """Each log thinned to a scan every 2 s; fixes are used half a second after their scan."""
    rows, learned = [], []
    for name in LOGS:
        reference = read_tum(logs / f"{name}.corrected.tum")
        paths, used_ns, known = trajectories(logs / f"{name}.log.gz")
        skipped = np.array([np.abs(used_ns - t).min() > _USED_NS for t in reference.stamps_ns])
        cells = [_summary(local_errors_m(paths[m], reference)[skipped]) for m in METHODS]
        rows.append((name, str(int(skipped.sum())), *cells))
        learned.append(_learned(name, known))
        effort.progress(" | ".join(rows[-1]))
    return Section(
        title="Recordings",
        text=_TEXT,
        tables=(
            Table(
                title="Position error in m at the skipped scans, median / rms / p95",
                columns=("log", "references", *METHODS),
                rows=tuple(rows),
            ),
            Table(
                title="What the filter learned of the wheels by the end",
                columns=("log", "travel", "turn", "bend rad/m", "wheels later than scans by s"),
                rows=tuple(learned),
            ),
        ),
    )


def trajectories(log: Path) -> tuple[dict[str, Trajectory], NDArray[np.int64], Calibration]:
    """Each method's pose at each wheel sample, the stamps of the scans used, what was learned."""
    samples = list(thin_scans(read_log(log).samples, _SCAN_PERIOD_S))
    params, odometry = SlamParams(), PoseOdometry()
    scans = [sample for sample in samples if isinstance(sample, Scan)]
    mountings = {one.scanner: Mounting(base_from_lidar=Pose2.identity()) for one in scans}
    robot = Localizer(
        LocalizerParams(), FilterParams(), params.clouds, odometry, mountings, "mapping"
    )
    engine = SlamEngine(params, PointMap(params.map), "mapping")
    wheels: list[OdometrySample] = []
    product: list[Pose2] = []
    fixes: list[tuple[int, SlamPose]] = []
    waiting: list[tuple[int, SlamResult]] = []
    for sample in samples:
        while waiting and waiting[0][0] <= sample.stamp_ns:
            robot.handle(waiting.pop(0)[1])
        robot.handle(sample)
        if isinstance(sample, OdometrySample):
            estimate = robot.estimate(sample.stamp_ns)
            if estimate is not None and (not wheels or sample.stamp_ns > wheels[-1].stamp_ns):
                wheels.append(sample)
                product.append(estimate.map_from_base)
        request = robot.take_request()
        if request is not None:
            result = engine.update(request)
            arrives_ns = result.stamp_ns + _DELAY_NS
            waiting.append((arrives_ns, result))
            fixes += [] if result.fix is None else [(arrives_ns, result.fix)]
    start, spread = Pose2.identity(), np.diag([1e-4, 1e-4, 1e-5])
    paths: dict[str, Sequence[Pose2]] = {
        PRODUCT: product,
        WHEELS: list(wheels_alone(wheels, odometry, start)),
        HELD: list(held(wheels, fixes, start)),
        UNDELAYED: list(undelayed(wheels, fixes, odometry, start, spread)),
    }
    stamps = np.array([sample.stamp_ns for sample in wheels], dtype=np.int64)
    assert robot.filter is not None
    return (
        {
            name: Trajectory(stamps_ns=stamps, poses=np.array([p.as_array() for p in path]))
            for name, path in paths.items()
        },
        np.array([scan.stamp_ns for scan in scans], dtype=np.int64),
        robot.filter.calibration,
    )


def local_errors_m(estimate: Trajectory, reference: Trajectory) -> Array:
    """(n,) distance at each reference after alignment by those within 20 s; NaN where too few."""
    poses, valid = poses_at(estimate, reference.stamps_ns, _GAP_S)
    errors = np.full(len(valid), np.nan)
    for row in np.flatnonzero(valid):
        near = np.abs(reference.stamps_ns - reference.stamps_ns[row]) <= _WINDOW_NS
        near &= valid
        if int(near.sum()) < _LEAST:
            continue
        to_reference = align_se2(poses[near], reference.poses[near])
        off = to_reference @ poses[row : row + 1, :2] - reference.poses[row, :2]
        errors[row] = np.hypot(*off[0])
    return errors


def _summary(errors: Array) -> str:
    one = ErrorSummary.of(errors[np.isfinite(errors)])
    return f"{one.median:.3f} / {one.rms:.3f} / {one.p95:.3f}"


def _learned(name: str, known: Calibration) -> tuple[str, ...]:
    return (
        name,
        f"{100.0 * known.travel:+.1f} ± {100.0 * known.travel_sigma:.1f} %",
        f"{100.0 * known.yaw:+.1f} ± {100.0 * known.yaw_sigma:.1f} %",
        f"{known.bend_radpm:+.3f} ± {known.bend_sigma_radpm:.3f}",
        f"{known.lag_s:+.3f} ± {known.lag_sigma_s:.3f}",
    )


_TEXT: Final = """Mapping from scratch with a scan every 2 s, wheels at their full rate; each fix
counts half a second after its scan. The frame of a mapping run drifts, and a log's reference has
errors of 3 to 5 cm of its own: each reference pose is compared after aligning the 20 s before and
after it. The figure holds what the pose does within such 40 s: the drift of the wheels between
scans, wrong fixes, corrections as they enter (online, each is a step of the path), and the
reference's own error; it does not hold the map's bending over minutes. Only references at scans
that were skipped count. A median much below the rms means that few windows hold most of the error;
which fixes made these was not traced. All methods but the product use the product's fixes."""
