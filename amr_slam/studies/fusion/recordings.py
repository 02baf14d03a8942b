"""The pose between scans on recordings of real robots, against references at the skipped scans."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.evaluation import ErrorSummary, align_se2, poses_at
from amr_slam.fusion import Calibration
from amr_slam.geometry import Array
from amr_slam.recording import Trajectory, read_log, read_tum
from amr_slam.studies.fusion.methods import METHODS, PRODUCT
from amr_slam.studies.fusion.recorded_drives import Drive, from_scratch, in_known_map
from amr_slam.studies.report import Effort, Section, Table
from amr_slam.studies.trials import percent

LOGS: Final = ("mit_csail", "intel")
_WINDOW_NS: Final = 20_000_000_000
_GAP_S: Final = 2.0
# As near to a used scan, a reference tells nothing about the time between scans.
_USED_NS: Final = 50_000_000
_LEAST: Final = 5
# No robot of these logs drives faster; their computers stamped late scans in bursts.
_FASTEST_MPS: Final = 3.0
_WORST: Final = (0.01, 0.05)
_REFERENCE_M: Final = 0.05
"""What the reference itself may be wrong by."""


def study(effort: Effort, logs: Path) -> Section:
    """Each log thinned to a scan every 2 s; fixes are used half a second after their scan."""
    known, claims, scratch, spread, learned = [], [], [], [], []
    for name in LOGS:
        log, reference = read_log(logs / f"{name}.log.gz"), read_tum(logs / f"{name}.corrected.tum")
        drive = in_known_map(name, log, reference)
        reference = steady(reference)
        errors = {m: absolute_errors_m(drive.paths[m], reference) for m in METHODS}
        known.append(_row(name, errors, drive, reference))
        claims.append(_claims(name, errors[PRODUCT], drive, reference))
        learned.append(_learned(name, drive.learned))
        effort.progress("claims: " + " | ".join(claims[-1]))
        effort.progress("in a map: " + " | ".join(known[-1]))
        drive = from_scratch(log)
        errors = {m: local_errors_m(drive.paths[m], reference) for m in METHODS}
        scratch.append(_row(name, errors, drive, reference))
        counted = errors[PRODUCT][_skipped(drive, reference)]
        far = _far_from_loops(drive, reference)[_skipped(drive, reference)]
        spread.append((name, *_spread(counted), *_without_loops(counted, far)))
        effort.progress("from scratch: " + " | ".join((*scratch[-1], *spread[-1])))
    columns = ("log", "references", *METHODS)
    return Section(
        title="Recordings",
        text=_TEXT,
        tables=(
            Table(
                title="In a map made at the reference poses: position error in m at the skipped "
                "scans, median / rms / p95",
                columns=columns,
                rows=tuple(known),
            ),
            Table(
                title="There, whether this product's pose was what it claimed to be",
                columns=(
                    "log",
                    "localized",
                    f"of these error below error95_m + {_REFERENCE_M:g} m",
                    "largest error m",
                    "its error95_m",
                ),
                rows=tuple(claims),
            ),
            Table(
                title="What the filter learned of the wheels by the end of these drives",
                columns=("log", "travel", "turn", "bend rad/m", "wheels later than scans by s"),
                rows=tuple(learned),
            ),
            Table(
                title="Mapping from scratch: the same after aligning the 20 s before and after",
                columns=columns,
                rows=tuple(scratch),
            ),
            Table(
                title="There, which references make this product's mean squared error",
                columns=(
                    "log",
                    *(f"the worst {100.0 * share:g} %" for share in _WORST),
                    "rms error m of the others",
                    "references with no loop within 20 s",
                    "their rms error m",
                ),
                rows=tuple(spread),
            ),
        ),
    )


def steady(reference: Trajectory) -> Trajectory:
    """The reference without the poses that are nearer in time to a neighbour than a robot can be:
    they are of another instant than their stamps say."""
    took_s = 1e-9 * np.diff(reference.stamps_ns)
    is_leap = np.hypot(*np.diff(reference.poses[:, :2], axis=0).T) > _FASTEST_MPS * took_s
    kept = ~(np.append(is_leap, False) | np.append(False, is_leap))
    return Trajectory(stamps_ns=reference.stamps_ns[kept], poses=reference.poses[kept])


def absolute_errors_m(estimate: Trajectory, reference: Trajectory) -> Array:
    """(n,) distance at each reference; NaN where the estimate has a gap."""
    poses, valid = poses_at(estimate, reference.stamps_ns, _GAP_S)
    off = np.hypot(*(poses[:, :2] - reference.poses[:, :2]).T)
    return np.where(valid, off, np.nan)


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


def _claims(name: str, errors_m: Array, drive: Drive, reference: Trajectory) -> tuple[str, ...]:
    skipped = _skipped(drive, reference) & np.isfinite(errors_m)
    stamps = drive.paths[PRODUCT].stamps_ns
    rows = np.searchsorted(stamps, reference.stamps_ns[skipped], side="right") - 1
    claimed_m, off_m = drive.claimed_m[rows], errors_m[skipped]
    good = np.isfinite(claimed_m)
    kept = off_m[good] <= claimed_m[good] + _REFERENCE_M
    worst = int(np.argmax(off_m[good]))
    return (
        name,
        percent(int(good.sum()), len(good)),
        percent(int(kept.sum()), len(kept)),
        f"{off_m[good][worst]:.2f}",
        f"{claimed_m[good][worst]:.2f}",
    )


def _skipped(drive: Drive, reference: Trajectory) -> NDArray[np.bool_]:
    """(n,) which references are at scans that the product did not get."""
    return np.array([np.abs(drive.used_ns - t).min() > _USED_NS for t in reference.stamps_ns])


def _row(
    name: str, errors: dict[str, Array], drive: Drive, reference: Trajectory
) -> tuple[str, ...]:
    skipped = _skipped(drive, reference)
    return name, str(int(skipped.sum())), *(_summary(errors[m][skipped]) for m in METHODS)


def _summary(errors: Array) -> str:
    one = ErrorSummary.of(errors[np.isfinite(errors)])
    return f"{one.median:.3f} / {one.rms:.3f} / {one.p95:.3f}"


def _spread(errors_m: Array) -> tuple[str, ...]:
    """Which part of the squared error the worst references hold, and the rms without them."""
    squares = np.sort(np.square(errors_m[np.isfinite(errors_m)]))[::-1]
    counts = [round(share * len(squares)) for share in _WORST]
    parts = [float(squares[:count].sum() / squares.sum()) for count in counts]
    others = float(np.sqrt(squares[counts[-1] :].mean()))
    return (*(f"{100.0 * part:.0f} %" for part in parts), f"{others:.3f}")


def _far_from_loops(drive: Drive, reference: Trajectory) -> NDArray[np.bool_]:
    """(n,) which references are aligned within 20 s in which no loop has moved the map."""
    after = np.searchsorted(drive.loops_ns, reference.stamps_ns - _WINDOW_NS)
    before = np.searchsorted(drive.loops_ns, reference.stamps_ns + _WINDOW_NS, side="right")
    return np.asarray(after == before)


def _without_loops(errors_m: Array, far: NDArray[np.bool_]) -> tuple[str, str]:
    known = np.isfinite(errors_m)
    rms_m = float(np.sqrt(np.mean(np.square(errors_m[known & far]))))
    return percent(int((known & far).sum()), int(known.sum())), f"{rms_m:.3f}"


def _learned(name: str, known: Calibration) -> tuple[str, ...]:
    return (
        name,
        f"{100.0 * known.travel:+.1f} ± {100.0 * known.travel_sigma:.1f} %",
        f"{100.0 * known.yaw:+.1f} ± {100.0 * known.yaw_sigma:.1f} %",
        f"{known.bend_radpm:+.3f} ± {known.bend_sigma_radpm:.3f}",
        f"{known.lag_s:+.3f} ± {known.lag_sigma_s:.3f}",
    )


_TEXT: Final = """Scans at least 2 s apart, wheels at their full rate; each fix counts half a
second after its scan. References at scans that were skipped count, so the figures are what the pose
does between scans. All methods but the product use the product's fixes. Left out are references
that a robot would have to drive faster than 3 m/s to or from: `intel` holds bursts of scans that
were stamped late, up to 20 cm within some milliseconds.

First, localized from the first reference pose on in a map of all scans at their reference poses;
the reference itself has errors of 3 to 5 cm, and wheel stamps of these logs are up to 0.2 s off.
Then mapping from scratch, whose frame drifts: each reference pose is compared after aligning the
20 s before and after it. That figure holds corrections as they enter (online, each is a step of the
path) and the map's bending within 40 s, which wheels alone do not have; it is no measure of the
fusion alone: where a loop is closed, the pose moves by what the map was wrong, and references
before and after it fit no common frame. Where few references make most of it, something went wrong
there: so [adr/0042](adr/0042-where-a-scan-joins-the-map.md) was found."""
