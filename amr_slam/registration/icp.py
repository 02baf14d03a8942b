"""Iterative Closest Point: the exact pose from a rough one (section 2.1 of the paper).

Two metrics: ``point`` is the paper's (closed-form least squares between nearest points), ``line``
measures along the map's normals under a robust kernel that narrows (Gauss-Newton). All initial
poses are refined at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.registration import information, kernels, visible
from amr_slam.registration.alignment import Alignment, Target

# Below this many correspondences three unknowns are not determined by noisy points.
_MIN_CORRESPONDENCES = 6
# Noise across the walls at which a map from such scans blurs things of the size of furniture: its
# square over this is how far a point may be off for that.
_COARSE_M = 0.13


@dataclass(frozen=True, slots=True, kw_only=True)
class IcpParams:
    """Correspondences, kernel and termination."""

    metric: Literal["line", "point"] = "line"
    """What is minimised: distance to the wall's line, or to its nearest point (the paper)."""
    reach_m: Annotated[float, Gt(0.0)] = 0.6
    """Correspondences farther apart are none. Also the kernel's first width."""
    kernel_m: Annotated[float, Gt(0.0)] = 0.12
    """Final width of the robust kernel; never less than three times the noise."""
    narrowing_iterations: Annotated[int, Ge(1)] = 6
    """Iterations in which the kernel narrows from the first to the final width."""
    max_iterations: Annotated[int, Ge(1), Le(500)] = 20
    """Where there is no convergence by then, the last pose is returned and says so."""
    normals_agree_deg: Annotated[float, Gt(0.0), Le(90.0)] = 45.0
    """Two surfaces that meet at more than this are not the same one."""
    tolerance_m: Annotated[float, Gt(0.0)] = 1e-3
    """Steps shorter than this (and than as many rad) end the iteration."""
    sigma_floor_m: Annotated[float, Gt(0.0)] = 0.02
    """Residuals are never believed to be better than this: the map has errors of its own."""
    correlation: Annotated[float, Ge(1.0)] = 4.0
    """This many neighbouring points count as one: they share the map's errors."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """A pose with its information, in the target frame: the wheels' word inside the ICP."""

    target_from_source: Pose2
    information: Array
    """(3, 3) inverse covariance of (x, y, theta)."""


def align(
    source: Cloud, target: Target, initial: Pose2, params: IcpParams, prior: Prior | None = None
) -> Alignment:
    """Refine one initial pose; see :func:`align_many`."""
    return align_many(source, target, [initial], params, prior)[0]


def align_many(
    source: Cloud,
    target: Target,
    initials: Sequence[Pose2],
    params: IcpParams,
    prior: Prior | None = None,
) -> list[Alignment]:
    """Refine every initial ``target_from_source``; the results keep the initials' order.

    ``prior`` is one more term of the least squares (metric ``line`` only): where the walls leave
    a direction open, as along a corridor, the wheels decide. The returned information is that of
    the points alone.
    """
    if not len(source) or not len(target):
        return [_nothing(pose) for pose in initials]
    poses = np.array([pose.as_array() for pose in initials]).reshape(-1, 3)
    return _conclude(source, target, refine(source, target, poses, params, prior), params)


def polish(
    source: Cloud,
    target: Target,
    alignment: Alignment,
    params: IcpParams,
    prior: Prior | None = None,
) -> Alignment:
    """The best place's last refinement, under noise: see :mod:`visible`. Where the scan is not
    noisy, or the pose would leave its place, ``alignment`` is returned as it is."""
    part = visible.share(source)
    if params.metric != "line" or part == 0.0 or not alignment.converged or not len(target):
        return alignment
    start = alignment.target_from_source.as_array()
    expected, known = start, np.zeros((3, 3))
    if prior is not None:
        expected, known = prior.target_from_source.as_array(), prior.information
    variance = _variance(source, params)
    step = visible.polish(source, target, start, variance, expected, known) - start
    step[2] = wrap_angle(float(step[2]))
    if np.abs(step).max() > _kernel(source, params):
        return alignment
    refined = Refined(
        (start + part * step)[None],
        np.array([alignment.iterations], dtype=np.int32),
        np.array([True]),
    )
    return _conclude(source, target, refined, params)[0]


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Where k poses went."""

    poses: Array
    """(k, 3) x m, y m, theta rad."""
    iterations: NDArray[np.int32]
    """(k,)."""
    converged: NDArray[np.bool_]
    """(k,)."""


def refine(
    source: Cloud, target: Target, poses: Array, params: IcpParams, prior: Prior | None = None
) -> Refined:
    """The iteration alone, from poses (k, 3): what a first pass over many candidates needs.

    ``source`` and ``target`` hold at least one point each.
    """
    if params.metric == "line" and ENABLED:
        expected = np.zeros(3) if prior is None else prior.target_from_source.as_array()
        return Refined(
            *kernels.refine_lines(
                source.points_m,
                source.normals,
                poses,
                target.points_m,
                target.normals,
                target.lookup.tiles,
                target.lookup.first,
                target.lookup.pool,
                target.lookup.layout,
                _reach(source, params),
                _least_agreement(params),
                _widths(source, params),
                params.max_iterations,
                params.tolerance_m,
                _variance(source, params),
                expected,
                np.zeros((3, 3)) if prior is None else prior.information,
            )
        )
    return _refine_in_numpy(source, target, poses, params, prior)


def _kernel(source: Cloud, params: IcpParams) -> float:
    return max(params.kernel_m, 3.0 * source.across_m)


def _reach(source: Cloud, params: IcpParams) -> float:
    return max(params.reach_m, _kernel(source, params))


def _widths(source: Cloud, params: IcpParams) -> Array:
    return np.geomspace(
        _reach(source, params), _kernel(source, params), params.narrowing_iterations
    )  # fmt: skip


def _variance(source: Cloud, params: IcpParams, rmse_m: float = 0.0) -> float:
    """Of one point's distance to its wall, as if the points were independent.

    The noise is of each point alone, the map's error (at least what the noise leaves of the
    residuals' ``rmse_m`` unexplained) is shared by neighbours: the larger of the two counts.
    """
    map_error = max(rmse_m**2 - source.across_m**2, params.sigma_floor_m**2)
    blurred_m = source.across_m**2 / _COARSE_M
    return max(params.correlation * map_error, 1.2 * source.across_m**2 + blurred_m**2)


def _least_agreement(params: IcpParams) -> float:
    return math.cos(math.radians(params.normals_agree_deg))


def _refine_in_numpy(
    source: Cloud, target: Target, poses: Array, params: IcpParams, prior: Prior | None
) -> Refined:
    poses = poses.copy()
    final = np.zeros(len(poses), dtype=np.int32)
    converged = np.zeros(len(poses), dtype=np.bool_)
    active = np.arange(len(poses))
    widths = _widths(source, params)
    narrowing = params.narrowing_iterations if params.metric == "line" else 0
    for iteration in range(params.max_iterations):
        width = widths[min(iteration, len(widths) - 1)]
        pairs = _correspond(source, target, poses[active], params)
        if params.metric == "point":
            step = _step_to_points(poses[active], pairs)
        else:
            variance = _variance(source, params)
            step = _step_to_lines(poses[active], pairs, width, variance, prior)
        poses[active] += step
        poses[active, 2] = wrap_angle(poses[active, 2])
        final[active] = iteration + 1
        done = np.all(np.abs(step) < params.tolerance_m, axis=1) & (iteration + 1 >= narrowing)
        converged[active[done]] = True
        active, last = active[~done], np.abs(step[~done]).max(axis=1)
        if not len(active):
            break
    else:
        # Correspondences that flip to and fro keep a pose moving by millimetres: good enough.
        converged[active[last < 10.0 * params.tolerance_m]] = True
    return Refined(poses, final, converged)


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Correspondences of k poses: rows are poses, columns the source's n points."""

    moved: Array  # (k, n, 2) source points in the target frame
    nearest: Array  # (k, n, 2) their nearest target points
    normals: Array  # (k, n, 2) the targets' normals, or zero
    valid: NDArray[np.bool_]  # (k, n)


def _correspond(source: Cloud, target: Target, poses: Array, params: IcpParams) -> _Pairs:
    c, s = np.cos(poses[:, 2:3]), np.sin(poses[:, 2:3])
    px, py = source.points_m[:, 0], source.points_m[:, 1]
    moved = np.stack([c * px - s * py + poses[:, 0:1], s * px + c * py + poses[:, 1:2]], axis=2)
    shape = moved.shape[:2]
    if params.metric == "point":
        row = np.asarray(target.tree.query(moved.reshape(-1, 2))[1]).reshape(shape)
        return _Pairs(
            moved, target.points_m[row], target.normals[row], np.ones(shape, dtype=np.bool_)
        )
    nx, ny = source.normals[:, 0], source.normals[:, 1]
    turned = np.stack([c * nx - s * ny, s * nx + c * ny], axis=2)
    index = target.lookup.rows(moved, turned)
    nearest, normals = target.points_m[index], target.normals[index]
    off = moved - nearest
    valid = (index >= 0) & (_dot(off, off) <= _reach(source, params) ** 2)
    valid &= (normals[..., 0] != 0.0) | (normals[..., 1] != 0.0)
    valid &= (_dot(turned, normals) >= _least_agreement(params)) | ~source.has_normal
    return _Pairs(moved, nearest, normals, valid)


def _dot(a: Array, b: Array) -> Array:
    """Products (k, n) of vectors (k, n, 2): a sum over an axis of two is slow in numpy."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])


def _step_to_points(poses: Array, pairs: _Pairs) -> Array:
    """The paper's step: closed-form rigid motion between matched points (k, 3)."""
    weight = pairs.valid.astype(np.float64)
    total = np.maximum(weight.sum(axis=1), 1.0)[:, None]
    mean_p = np.einsum("kn,knd->kd", weight, pairs.moved) / total
    mean_q = np.einsum("kn,knd->kd", weight, pairs.nearest) / total
    p, q = pairs.moved - mean_p[:, None], pairs.nearest - mean_q[:, None]
    cross = np.einsum("kn,kn->k", weight, p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0])
    dot = np.einsum("kn,kn->k", weight, np.sum(p * q, axis=2))
    turn = np.arctan2(cross, dot)
    c, s = np.cos(turn), np.sin(turn)
    arm = poses[:, :2] - mean_p
    moved = np.stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]], axis=1)
    return np.column_stack([mean_q + moved - poses[:, :2], turn])


def _normal_equations(poses: Array, pairs: _Pairs, width: float) -> tuple[Array, Array]:
    """Gauss-Newton system of the point-to-line distances under a Geman-McClure kernel.

    Unknowns: displacement of the robot (x, y) in the target frame and its turn.
    """
    residual = _dot(pairs.normals, pairs.moved - pairs.nearest)
    weight = np.where(pairs.valid, 1.0 / (1.0 + (residual / width) ** 2) ** 2, 0.0)
    arm = pairs.moved - poses[:, None, :2]
    lever = pairs.normals[..., 1] * arm[..., 0] - pairs.normals[..., 0] * arm[..., 1]
    jacobian = np.concatenate([pairs.normals, lever[..., None]], axis=2)
    weighted = jacobian * weight[..., None]
    hessian = np.matmul(weighted.transpose(0, 2, 1), jacobian)
    gradient = np.matmul(weighted.transpose(0, 2, 1), residual[..., None])[..., 0]
    return hessian, gradient


def _step_to_lines(
    poses: Array, pairs: _Pairs, width: float, variance: float, prior: Prior | None
) -> Array:
    hessian, gradient = _normal_equations(poses, pairs, width)
    hessian, gradient = hessian / variance, gradient / variance
    if prior is not None:
        error = poses - prior.target_from_source.as_array()
        error[:, 2] = wrap_angle(error[:, 2])
        hessian = hessian + prior.information
        gradient = gradient + error @ prior.information
    # A little damping: a direction that nothing determines stays where it is.
    hessian = hessian + np.diag([1.0, 1.0, 1.0])
    step = -np.asarray(np.linalg.solve(hessian, gradient[..., None])[..., 0], dtype=np.float64)
    # Beyond a metre or a radian the linearisation says nothing.
    return np.clip(step, -1.0, 1.0)


def _conclude(
    source: Cloud, target: Target, refined: Refined, params: IcpParams
) -> list[Alignment]:
    poses, kernel = refined.poses, _kernel(source, params)
    pairs = _correspond(source, target, poses, params)
    if params.metric == "line":
        residual = np.abs(_dot(pairs.normals, pairs.moved - pairs.nearest))
    else:
        residual = np.linalg.norm(pairs.moved - pairs.nearest, axis=2)
    inlier = pairs.valid & (residual <= kernel)
    count = inlier.sum(axis=1)
    rmse = np.sqrt(np.sum(np.where(inlier, residual**2, 0.0), axis=1) / np.maximum(count, 1))
    residual = _dot(pairs.normals, pairs.moved - pairs.nearest)
    weight = np.where(pairs.valid, 1.0 / (1.0 + (residual / kernel) ** 2) ** 2, 0.0)
    hessian = [
        information.of_points(
            source.normals @ Pose2.from_array(poses[k]).rotation.T,
            pairs.normals[k],
            pairs.moved[k] - poses[k, :2],
            weight[k],
        )
        for k in range(len(poses))
    ]
    return [
        Alignment(
            target_from_source=Pose2.from_array(poses[k]),
            information=hessian[k] / _variance(source, params, float(rmse[k])),
            converged=bool(refined.converged[k]) and int(count[k]) >= _MIN_CORRESPONDENCES,
            iterations=int(refined.iterations[k]),
            inliers=float(count[k]) / len(source),
            rmse_m=float(rmse[k]),
        )
        for k in range(len(poses))
    ]


def points_alone(alignment: Alignment, prior: Prior) -> tuple[Pose2, Array]:
    """Pose and covariance (3, 3) as the points alone tell them, the prior taken out again.

    A filter that already knows the prior must not hear it twice. With H the points' information,
    L the prior's, and x the joint optimum, the points' own optimum is x + H^-1 L (x - prior).
    Directions in which the points know less than a fifth of what the prior knew (along a
    corridor) keep x, with a covariance that says so.
    """
    joint = alignment.target_from_source
    pulled = joint.as_array() - prior.target_from_source.as_array()
    pulled[2] = wrap_angle(float(pulled[2]))
    root = np.linalg.cholesky(prior.information)
    whiten = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(whiten @ alignment.information @ whiten.T)
    release = np.where(ratio > 0.2, 1.0 / np.maximum(ratio, 0.2), 0.0)
    back = whiten.T @ axes
    shift = back @ (release * (axes.T @ (root.T @ pulled)))
    covariance = (back / np.maximum(ratio, 1e-6)) @ back.T
    return Pose2.from_array(joint.as_array() + shift), 0.5 * (covariance + covariance.T)


def _nothing(pose: Pose2) -> Alignment:
    return Alignment(
        target_from_source=pose,
        information=np.zeros((3, 3)),
        converged=False,
        iterations=0,
        inliers=0.0,
        rmse_m=0.0,
    )
