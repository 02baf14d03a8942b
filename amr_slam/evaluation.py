"""How far an estimate is from a reference, and whether it knew.

Trajectory error after Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS
2012; relations after Kuemmerle et al., Autonomous Robots 27, 2009; consistency after Bar-Shalom,
"Estimation with applications to tracking and navigation", section 5.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2, rotation_matrix, wrap_angle
from amr_slam.recording import Relations, Trajectory

# Spread of positions below which they tell nothing about a rotation.
_SPREAD_M = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorSummary:
    """Statistics of the sizes of many errors, in the unit that the owner's name says."""

    rms: float
    mean: float
    median: float
    p95: float
    max: float

    @staticmethod
    def of(errors: Array) -> ErrorSummary:
        """Of (n,) errors, signs ignored. Raises ValueError when there is none."""
        if len(errors) == 0:
            raise ValueError("no errors to summarize")
        sizes = np.abs(errors)
        return ErrorSummary(
            rms=float(np.sqrt(np.mean(sizes**2))),
            mean=float(np.mean(sizes)),
            median=float(np.median(sizes)),
            p95=float(np.percentile(sizes, 95.0)),
            max=float(np.max(sizes)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryError:
    """Difference of two trajectories at the reference's stamps."""

    position_m: ErrorSummary
    heading_deg: ErrorSummary
    matched: int
    """Stamps of the reference at which the estimate had a pose."""
    reference_from_estimate: Pose2
    """The alignment applied before; the identity where none was asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RelationsError:
    """Difference of relative displacements, which needs no common frame."""

    position_m: ErrorSummary
    heading_deg: ErrorSummary
    matched: int
    """Relations both of whose ends the estimate has."""
    total: int


def align_se2(estimate: Array, reference: Array) -> Pose2:
    """``reference_from_estimate`` with the least squared distances between (n, 3) poses.

    Umeyama's solution without scale, IEEE PAMI 13(4), 1991, from positions; where all positions
    are one, headings decide. Raises ValueError when there are no poses.
    """
    if len(estimate) == 0 or estimate.shape != reference.shape:
        raise ValueError(f"cannot align {estimate.shape} with {reference.shape}")
    a, b = estimate[:, :2].mean(axis=0), reference[:, :2].mean(axis=0)
    moment = (estimate[:, :2] - a).T @ (reference[:, :2] - b) / len(estimate)
    dot, cross = moment[0, 0] + moment[1, 1], moment[0, 1] - moment[1, 0]
    if math.hypot(dot, cross) > _SPREAD_M**2:
        theta_rad = math.atan2(cross, dot)
    else:
        turn = reference[:, 2] - estimate[:, 2]
        theta_rad = math.atan2(float(np.mean(np.sin(turn))), float(np.mean(np.cos(turn))))
    x, y = b - rotation_matrix(theta_rad) @ a
    return Pose2(float(x), float(y), theta_rad)


def poses_at(
    trajectory: Trajectory, stamps_ns: NDArray[np.int64], max_gap_s: float = 0.5
) -> tuple[Array, NDArray[np.bool_]]:
    """(n, 3) poses of a trajectory at (n,) stamps, and (n,) whether it has one there.

    Between two poses no more than ``max_gap_s`` apart it goes straight and turns the short way;
    further from any pose, and before and after the trajectory, it has none.
    """
    known = trajectory.stamps_ns
    if len(known) == 0:
        return np.full((len(stamps_ns), 3), np.nan), np.zeros(len(stamps_ns), dtype=np.bool_)
    after = np.searchsorted(known, stamps_ns)
    exact = known[np.minimum(after, len(known) - 1)] == stamps_ns
    right = np.minimum(after, len(known) - 1)
    left = np.where(exact, right, np.maximum(after - 1, 0))
    gap_ns = known[right] - known[left]
    inside = (stamps_ns >= known[0]) & (stamps_ns <= known[-1])
    valid = exact | (inside & (gap_ns <= 1e9 * max_gap_s))
    part = np.where(valid & ~exact, (stamps_ns - known[left]) / np.maximum(gap_ns, 1), 0.0)
    start, end = trajectory.poses[left], trajectory.poses[right]
    step = end - start
    step[:, 2] = wrap_angle(step[:, 2])
    poses = start + part[:, None] * step
    poses[:, 2] = wrap_angle(poses[:, 2])
    poses[~valid] = np.nan
    return poses, valid


def associate(
    estimate: Trajectory, reference: Trajectory, max_gap_s: float = 0.5
) -> tuple[Array, Array]:
    """(k, 3) poses of both at those stamps of the reference that the estimate covers."""
    poses, valid = poses_at(estimate, reference.stamps_ns, max_gap_s)
    return poses[valid], reference.poses[valid]


def absolute_trajectory_error(
    estimate: Trajectory, reference: Trajectory, *, align: bool = True, max_gap_s: float = 0.5
) -> TrajectoryError:
    """Error of an estimate at the stamps of a reference, each in its own frame (``align``) or
    both in one. Raises ValueError when the two have no stamp in common."""
    poses, wanted = associate(estimate, reference, max_gap_s)
    if len(poses) == 0:
        raise ValueError("estimate and reference have no time in common")
    alignment = align_se2(poses, wanted) if align else Pose2.identity()
    offset = alignment @ poses[:, :2] - wanted[:, :2]
    turn = wrap_angle(poses[:, 2] + alignment.theta_rad - wanted[:, 2])
    return TrajectoryError(
        position_m=ErrorSummary.of(np.hypot(*offset.T)),
        heading_deg=ErrorSummary.of(np.degrees(turn)),
        matched=len(poses),
        reference_from_estimate=alignment,
    )


def relations_error(
    estimate: Trajectory, relations: Relations, max_gap_s: float = 0.5
) -> RelationsError:
    """Error of the displacements between pairs of instants (Kuemmerle et al.).

    Raises ValueError when the estimate covers no pair.
    """
    starts, has_start = poses_at(estimate, relations.start_ns, max_gap_s)
    ends, has_end = poses_at(estimate, relations.end_ns, max_gap_s)
    both = has_start & has_end
    if not both.any():
        raise ValueError("the estimate covers no relation")
    found = _relative(starts[both], ends[both])
    errors = _relative(relations.start_from_end[both], found)
    return RelationsError(
        position_m=ErrorSummary.of(np.hypot(errors[:, 0], errors[:, 1])),
        heading_deg=ErrorSummary.of(np.degrees(errors[:, 2])),
        matched=int(both.sum()),
        total=len(relations),
    )


def _relative(start: Array, end: Array) -> Array:
    """(n, 3): each row of ``inverse(start) @ end``."""
    offset = end[:, :2] - start[:, :2]
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    return np.column_stack(
        [
            c * offset[:, 0] + s * offset[:, 1],
            c * offset[:, 1] - s * offset[:, 0],
            wrap_angle(end[:, 2] - start[:, 2]),
        ]
    )


def nees(errors: Array, covariances: Array) -> Array:
    """(n,) normalized squared size of (n, d) errors under their (n, d, d) covariances.

    An honest covariance gives d on average. Raises numpy.linalg.LinAlgError on a singular one.
    """
    solved = np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]
    normalized: Array = np.einsum("nd,nd->n", errors, solved)
    return normalized


def error95_coverage(position_errors_m: Array, error95_m: Array) -> float:
    """Share of position errors within the reported ``error95_m``: 0.95 if it is honest.

    Raises ValueError when there are none.
    """
    if len(position_errors_m) == 0:
        raise ValueError("no errors to judge")
    return float(np.mean(np.abs(position_errors_m) <= error95_m))
