"""The last refinement of a map on a floor plan: along the plan's normals, under a robust kernel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from amr_slam.aligning.plan import FloorPlan
from amr_slam.geometry import Array, Pose2, inverse_matrix
from amr_slam.registration.alignment import Target

_STEPS: Final = 15
_FACING: Final = 0.7
"""Cosine: surfaces that meet at more than 45 degrees are not the same one."""
_WITNESS_M: Final = 3.0
"""Points along a wall share its errors: so much of a wall counts as one witness."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exact:
    """Where the map lies, and how sure that is."""

    site_from_map: Pose2
    sigma_m: float
    """Standard deviation of a place in the middle of the map, in each direction ..."""
    sigma_rad: float
    """... and of the turn."""
    scale: float
    """Plan over map, as measured; not applied."""
    scale_sigma: float
    points_m: Array
    """(n, 2) the map's wall points that are in the plan, in the site's frame."""
    offsets_m: Array
    """(n,) how far beside them the plan's wall is."""

    @property
    def rms_m(self) -> float:
        return float(np.sqrt(np.mean(self.offsets_m**2)))

    @property
    def p95_m(self) -> float:
        return float(np.percentile(np.abs(self.offsets_m), 95.0))


def refined(walls: Target, plan: FloorPlan, start: Pose2, near_m: float, middle: Pose2) -> Exact:
    """From ``start`` (site_from_map), by walls within ``near_m`` of the plan's that face the same
    way. A scale about ``middle`` (map_from_middle) is estimated beside, and not applied."""
    tree = cKDTree(plan.points_m)
    pose, scale = start, 1.0
    rigid = pose
    for stretching in (False, True):
        for _ in range(_STEPS):
            table, off, _ = _system(walls, plan, tree, pose @ middle, middle, near_m, scale)
            root = 1.0 / (1.0 + (off / (0.5 * near_m)) ** 2)
            used = table if stretching else table[:, :3]
            step = np.linalg.lstsq(used * root[:, None], off * root, rcond=None)[0]
            centre = Pose2.from_array((pose @ middle).as_array() + step[:3])
            pose = centre @ middle.inverse()
            scale += float(step[3]) if stretching else 0.0
        rigid = rigid if stretching else pose
    table, off, points = _system(walls, plan, tree, rigid @ middle, middle, near_m, 1.0)
    noise = float(np.mean(off**2)) * _WITNESS_M / walls.spacing_m if len(off) else math.inf
    sigmas = [
        np.sqrt(noise * np.diag(inverse_matrix(part.T @ part + 1e-9 * np.eye(part.shape[1]))))
        for part in (table[:, :3], table)
    ]
    return Exact(
        site_from_map=rigid,
        sigma_m=math.sqrt(float(np.mean(sigmas[0][:2] ** 2))),
        sigma_rad=float(sigmas[0][2]),
        scale=scale,
        scale_sigma=float(sigmas[1][3]),
        points_m=points,
        offsets_m=off,
    )


def _system(
    walls: Target,
    plan: FloorPlan,
    tree: cKDTree,
    centre: Pose2,
    middle: Pose2,
    near_m: float,
    scale: float,
) -> tuple[Array, Array, Array]:
    """Rows (n, 4) by shift, turn and scale about the middle, which lies at ``centre``; distances
    (n,) still to go; the points (n, 2) where they are."""
    at = centre.translation
    moved = at + scale * ((centre @ (middle.inverse() @ np.array(walls.points_m))) - at)
    distance, row = tree.query(moved, distance_upper_bound=2.0 * near_m)
    found = np.isfinite(distance)
    row = np.where(found, row, 0)
    normals = plan.normals[row]
    turned = walls.normals @ (centre @ middle.inverse()).rotation.T
    off = np.sum((plan.points_m[row] - moved) * normals, axis=1)
    used = found & (np.sum(turned * normals, axis=1) > _FACING) & (np.abs(off) <= near_m)
    moved, normals, off = moved[used], normals[used], off[used]
    arm = moved - at
    lever = normals[:, 1] * arm[:, 0] - normals[:, 0] * arm[:, 1]
    along = np.sum(normals * arm, axis=1)
    return np.column_stack([normals, lever, along]), off, moved
