"""The last stage of registration under noise: each beam against the walls that its ray can meet.

The nearest wall of a noisy point is often one that the beam cannot see, behind or beside the one
that it hit; pairs of nearest points then pull the pose away from the truth by more than the noise
does. Here a point may belong to the walls that its own ray and the rays beside it meet first,
each with the probability that the noise carried it from there, or to none (a soft assignment, as
in Granger and Pennec, "Multi-scale EM-ICP", ECCV 2002, but over the visible surface). The map of
noisy scans has fragments that are no walls: a ray passes each wall with a certain probability.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import scipy

from amr_slam.clouds import Cloud
from amr_slam.compiled import ENABLED, jit
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.registration import casting
from amr_slam.registration.alignment import Target

# A ray ends at a wall of the map with this probability, else it goes on to the next.
_OPAQUE: Final = 0.65
_WALLS: Final = 3
# Walls nearer behind one another are one, broken by the map's cells: at least this, in m.
_THICKNESS_M: Final = 0.2
# Probability density of a stray point, as a share of that of a point on its wall.
_STRAY: Final = 0.03
# Rays to each side of a beam's own, half a standard deviation of the noise apart.
_BESIDE: Final = 5
_ITERATIONS: Final = 3
# Noise across the walls at which this stage begins to count, and from which on it counts alone.
_BEGIN_M, _ALONE_M = 0.015, 0.04


def share(source: Cloud) -> float:
    """How much this stage counts against nearest points, by the noise: 0 to 1, without a step."""
    return min(max((source.across_m - _BEGIN_M) / (_ALONE_M - _BEGIN_M), 0.0), 1.0)


def polish(
    source: Cloud, target: Target, start: Array, variance: float, expected: Array, known: Array
) -> Array:
    """Gauss-Newton on the distances to the visible walls from a pose (3,) near the optimum.

    ``variance``: of one point's distance, in m2, which weighs the points against the prior of
    pose ``expected`` (3,) and information ``known`` (3, 3), which may be zero.
    """
    beams = source.points_m - source.origins_m
    reach = np.hypot(beams[:, 0], beams[:, 1])
    beams = beams / np.maximum(reach, 1e-9)[:, None]
    strides = _strides(beams, reach, source.across_m)
    # What a point may come from is no farther than it and its neighbours are, and the noise.
    far = scipy.ndimage.maximum_filter1d(reach, 2 * _BESIDE + 1) + 3.0 * source.sigma_m
    pose = start
    prior = np.asarray(np.eye(3) + known)  # a direction that nothing determines stays
    here = Pose2.from_array(pose)
    # Cast once: the pose hardly moves, and the walls that the rays meet do not.
    depths, lines = _walls(target, here @ source.origins_m, beams @ here.rotation.T, far)
    for _ in range(_ITERATIONS):
        here = Pose2.from_array(pose)
        moved, origins = here @ source.points_m, here @ source.origins_m
        directions = beams @ here.rotation.T
        equations = _equations if ENABLED else _equations_in_numpy
        hessian, gradient = equations(
            moved, origins, directions, strides, depths, lines, pose[:2],
            source.sigma_m, source.across_m,
        )  # fmt: skip
        off = pose - expected
        off[2] = wrap_angle(float(off[2]))
        step = np.linalg.solve(hessian / variance + prior, gradient / variance + known @ off)
        pose = pose - np.clip(step, -0.2, 0.2)
    pose[2] = wrap_angle(float(pose[2]))
    return np.asarray(pose)


def _strides(beams: Array, reach: Array, across_m: float) -> Array:
    """(n,) how many beams apart rays are half a standard deviation apart at each point."""
    turn = beams[:-1, 0] * beams[1:, 1] - beams[:-1, 1] * beams[1:, 0]
    step = float(np.median(np.abs(turn))) if len(turn) else 0.0
    apart = np.maximum(reach * step, 1e-6)
    return np.maximum(np.round(0.5 * across_m / apart), 1.0).clip(max=1e6).astype(np.int64)


def _walls(target: Target, origins: Array, directions: Array, far: Array) -> tuple[Array, Array]:
    """Depths (n, walls) in m of the walls that each ray meets up to ``far`` (n,), inf where
    there are no more, and the walls' lines (n, walls, 3): normal and its product with a point."""
    n = len(origins)
    depths = np.full((n, _WALLS), np.inf)
    lines = np.zeros((n, _WALLS, 3))
    base = np.zeros(n)
    active = np.arange(n)
    for k in range(_WALLS):
        if not len(active):
            break
        begin = origins[active] + base[active, None] * directions[active]
        most = float(np.max(far[active] - base[active]))
        depth = base[active] + casting.ranges(target, begin, directions[active], most)
        met = depth <= far[active]
        active, depth = active[met], depth[met]
        ends = origins[active] + depth[:, None] * directions[active]
        row = target.lookup.rows(ends, np.zeros_like(ends))
        normals = target.normals[row]
        depths[active, k] = depth
        lines[active, k, :2] = normals
        lines[active, k, 2] = np.sum(normals * target.points_m[row], axis=1)
        base[active] = depth + _THICKNESS_M
        active = active[base[active] < far[active]]
    return depths, lines


@jit
def _equations(  # noqa: PLR0917
    moved: Array,
    origins: Array,
    directions: Array,
    strides: Array,
    depths: Array,
    lines: Array,
    centre: Array,
    along: float,
    across: float,
) -> tuple[Array, Array]:
    """Gauss-Newton system (3, 3), (3,) of n points, see :func:`polish`.

    Row j of ``origins``, ``directions`` (n, 2), ``depths`` (n, walls) and ``lines`` (n, walls, 3)
    is ray j; a point may come from a ray if the noise ``along`` and ``across`` it (m) allows.
    """
    n, walls = depths.shape
    hxx = hxy = hxt = hyy = hyt = htt = 0.0
    gx = gy = gt = 0.0
    weights = np.zeros((2 * _BESIDE + 1, walls))
    for i in range(n):
        possible = 0.0
        total = 0.0
        for a in range(2 * _BESIDE + 1):
            j = i + (a - _BESIDE) * strides[i]
            for k in range(walls):
                weights[a, k] = 0.0
            if j < 0 or j >= n:
                continue
            ux, uy = moved[i, 0] - origins[j, 0], moved[i, 1] - origins[j, 1]
            depth = ux * directions[j, 0] + uy * directions[j, 1]
            beside = (uy * directions[j, 0] - ux * directions[j, 1]) / across
            if depth <= 0.0 or abs(beside) > 3.0:
                continue
            chance = math.exp(-0.5 * beside * beside)
            possible += chance
            for k in range(walls):
                beyond = (depth - depths[j, k]) / along
                if abs(beyond) < 4.0 and (lines[j, k, 0] != 0.0 or lines[j, k, 1] != 0.0):
                    weights[a, k] = chance * _OPAQUE * math.exp(-0.5 * beyond * beyond)
                    total += weights[a, k]
                chance *= 1.0 - _OPAQUE
        total += _STRAY * possible
        if total <= 0.0:
            continue
        ax, ay = moved[i, 0] - centre[0], moved[i, 1] - centre[1]
        for a in range(2 * _BESIDE + 1):
            j = i + (a - _BESIDE) * strides[i]
            for k in range(walls):
                weight = weights[a, k] / total
                if weight == 0.0:
                    continue
                qx, qy = lines[j, k, 0], lines[j, k, 1]
                residual = qx * moved[i, 0] + qy * moved[i, 1] - lines[j, k, 2]
                lever = qy * ax - qx * ay
                hxx += weight * qx * qx
                hxy += weight * qx * qy
                hxt += weight * qx * lever
                hyy += weight * qy * qy
                hyt += weight * qy * lever
                htt += weight * lever * lever
                gx += weight * residual * qx
                gy += weight * residual * qy
                gt += weight * residual * lever
    hessian = np.array([[hxx, hxy, hxt], [hxy, hyy, hyt], [hxt, hyt, htt]])
    return hessian, np.array([gx, gy, gt])


def _equations_in_numpy(  # noqa: PLR0917
    moved: Array,
    origins: Array,
    directions: Array,
    strides: Array,
    depths: Array,
    lines: Array,
    centre: Array,
    along: float,
    across: float,
) -> tuple[Array, Array]:
    """What :func:`_equations` does, all points at once."""
    n, walls = depths.shape
    ray = np.arange(n)[:, None] + np.arange(-_BESIDE, _BESIDE + 1) * strides[:, None]
    inside = (ray >= 0) & (ray < n)
    ray = np.where(inside, ray, 0)
    u, d = moved[:, None] - origins[ray], directions[ray]
    depth = np.sum(u * d, axis=2)
    beside = (u[..., 1] * d[..., 0] - u[..., 0] * d[..., 1]) / across
    near = inside & (depth > 0.0) & (np.abs(beside) <= 3.0)
    chance = np.where(near, np.exp(-0.5 * beside**2), 0.0)
    line = lines[ray]
    beyond = (depth[..., None] - depths[ray]) / along
    can = (np.abs(beyond) < 4.0) & np.any(line[..., :2] != 0.0, axis=3)
    weight = np.where(can, np.exp(-0.5 * np.where(can, beyond, 0.0) ** 2), 0.0)
    weight *= chance[..., None] * _OPAQUE * (1.0 - _OPAQUE) ** np.arange(walls)
    total = weight.sum(axis=(1, 2)) + _STRAY * chance.sum(axis=1)
    weight /= np.where(total > 0.0, total, 1.0)[:, None, None]
    residual = np.einsum("narc,nc->nar", line[..., :2], moved) - line[..., 2]
    arm = moved - centre
    lever = line[..., 1] * arm[:, None, None, 0] - line[..., 0] * arm[:, None, None, 1]
    jacobian = np.stack([line[..., 0], line[..., 1], lever], axis=-1).reshape(-1, 3)
    weighted = jacobian * weight.reshape(-1, 1)
    return np.asarray(weighted.T @ jacobian), np.asarray(weighted.T @ residual.ravel())
