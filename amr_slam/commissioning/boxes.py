"""A box that is not there yet: where it could stand, and the map as it would be with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amr_slam.clouds import CloudParams
from amr_slam.commissioning.places import thinned
from amr_slam.commissioning.viewing import Eye
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.registration.alignment import Target
from amr_slam.registration.casting import ranges
from amr_slam.simulation.casting import cast
from amr_slam.simulation.shapes import box, edges

# Between the wall and what stands at it.
_GAP_M = 0.03
# A wall farther behind it than this is not the one that it stands at.
_BEHIND_M = 0.15
# A wall inside of it is no farther than this from the points with which it is looked for.
_INSIDE_M = 0.07
# So far behind it, a wall is hidden.
_HIDDEN_M = 0.3
# The robot's middle passed no nearer to it than this.
_DRIVEN_M = 0.35
# A corner is where another wall stands within this.
_CORNER_M = 1.2
_CORNER_BONUS = 1.25
# How often the box is "seen": it counts as much as a wall that many scans saw.
_LOOKS = 20.0
# No box is worth more to a pose than this share of its scan.
_ENOUGH = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """What people may put there."""

    name: str
    width_m: float
    depth_m: float


PALLET_BOX = Shape(name="box", width_m=1.2, depth_m=0.8)
"""A pallet box, or a cabinet of that size."""
TWO_BOXES = Shape(name="row of two boxes", width_m=2.4, depth_m=0.8)
"""Or anything else of that size."""
POST = Shape(name="post", width_m=0.4, depth_m=0.3)
"""A narrow cabinet, or a post."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """One at its place."""

    shape: Shape
    pose: Pose2
    """Of its middle in the map; x along its width, y away from the wall."""
    corner: bool
    """Whether it stands in a corner."""

    @property
    def corners_m(self) -> Array:
        """(4, 2) in the map."""
        return self.pose @ box(self.shape.width_m, self.shape.depth_m)

    def within(self, points_m: Array, margin_m: float) -> NDArray[np.bool_]:
        """(n,) whether points (n, 2) of the map lie in it or this near to its sides."""
        x, y = np.abs((self.pose.inverse() @ points_m).T)
        half_m = 0.5 * self.shape.width_m + margin_m, 0.5 * self.shape.depth_m + margin_m
        return np.asarray((x < half_m[0]) & (y < half_m[1]))


def candidates(
    known: PointMap, near_m: Array, reach_m: float, shape: Shape, passage_m: float
) -> list[Box]:
    """Places for it at walls within ``reach_m`` of some of the points (n, 2) ``near_m``, which
    leave ``passage_m`` before it and are not where the robot drove when it made the map."""
    target = known.target()
    faced = np.any(target.normals != 0.0, axis=1)
    points, normals = target.points_m[faced], target.normals[faced]
    if not len(points) or not len(near_m):
        return []
    near = np.isfinite(cKDTree(near_m).query(points, distance_upper_bound=reach_m)[0])
    points, normals = points[near], normals[near]
    if not len(points):
        return []
    chosen, _ = thinned(points, max(40, len(points) // 10), target.spacing_m)
    normals = normals[cKDTree(points).query(chosen)[1]]
    driven = np.array([pose.translation for _, pose in known.path]).reshape(-1, 2)
    tried = (
        _at_wall(target, point, normal, shape, passage_m)
        for point, normal in zip(chosen, normals, strict=True)
    )
    return [one for one in tried if one is not None and not one.within(driven, _DRIVEN_M).any()]


def _at_wall(
    target: Target,
    point: Array,
    normal: Array,
    shape: Shape,
    passage_m: float,
) -> Box | None:
    middle = point + (0.5 * shape.depth_m + _GAP_M) * normal
    along = np.array([normal[1], -normal[0]])
    pose = Pose2(middle[0], middle[1], float(np.arctan2(along[1], along[0])))
    front = np.linspace(-0.5, 0.5, 5)[:, None] * shape.width_m * along
    front = front + middle + 0.5 * shape.depth_m * normal
    if not np.all(target.lookup.seen_free(front + 0.1 * normal)):
        return None
    # There is wall behind all of it: it closes no door.
    backwards = np.broadcast_to(-normal, front.shape).copy()
    back = front - (shape.depth_m - 0.1) * normal
    if float(ranges(target, back, backwards, 1.0).max()) > 0.1 + _BEHIND_M:
        return None
    # Nothing stands in it, and there is room to pass.
    if np.any(np.asarray(target.tree.query(pose @ _filled(shape, 0.1))[0]) < _INSIDE_M):
        return None
    ahead = ranges(target, front, np.broadcast_to(normal, front.shape).copy(), 30.0)
    if float(ahead.min()) < passage_m:
        return None
    sides = np.array([middle, middle])
    beside = ranges(target, sides, np.array([along, -along]), 30.0)
    corner = float(beside.min()) <= 0.5 * shape.width_m + _CORNER_M
    return Box(shape=shape, pose=pose, corner=corner)


def _filled(shape: Shape, spacing_m: float) -> Array:
    """(n, 2) points inside a shape about the origin, a little from its border."""
    x = np.arange(-0.5 * shape.width_m + 0.06, 0.5 * shape.width_m - 0.05, spacing_m)
    y = np.arange(-0.5 * shape.depth_m + 0.06, 0.5 * shape.depth_m - 0.05, spacing_m)
    grid = np.meshgrid(x, y)
    return np.column_stack([grid[0].ravel(), grid[1].ravel()])


def ranked(
    boxes: Sequence[Box],
    target: Target,
    eyes: Sequence[Eye],
    poses: Sequence[Sequence[Pose2]],
    params: CloudParams,
) -> list[Box]:
    """By how much of the scans at these poses they would be, most first; without those that no
    pose sees. Of several poses that stand for one, that which sees most counts: a box tells two
    places apart for a robot in either."""
    gains = np.zeros(len(boxes))
    for several in poses:
        gains += np.max([_gains(boxes, target, eyes, pose, params) for pose in several], axis=0)
    order = np.argsort(-gains, kind="stable")
    return [boxes[row] for row in order if gains[row] > 0.0]


def _gains(
    boxes: Sequence[Box],
    target: Target,
    eyes: Sequence[Eye],
    pose: Pose2,
    params: CloudParams,
) -> Array:
    """(n,) share of the scan's surface at a pose that each box would be."""
    gains = np.zeros(len(boxes))
    if boxes:
        rays = [eye.rays(pose) for eye in eyes]
        origins, directions = (np.concatenate(part) for part in zip(*rays, strict=True))
        to_wall = ranges(target, origins, directions, params.range_max_m)
        angles = np.arctan2(directions[:, 1], directions[:, 0])
        steps = np.concatenate([np.full(e.model.beams, abs(e.model.angle_step_rad)) for e in eyes])
        surface = np.where(np.isfinite(to_wall), np.minimum(to_wall * steps / 0.05, 1.0), 0.0)
        whole = max(float(surface.sum()), 1e-9)
        for row, one in enumerate(boxes):
            if np.hypot(*(one.pose.translation - pose.translation)) > params.range_max_m:
                continue
            to_box = cast(origins, angles, edges(one.corners_m))
            met = to_box < to_wall - 0.05
            share = float(np.minimum(to_box[met] * steps[met] / 0.05, 1.0).sum()) / whole
            gains[row] = min(share, _ENOUGH) * (_CORNER_BONUS if one.corner else 1.0)
    return gains


def spread(boxes: Sequence[Box], most: int, apart_m: float) -> list[Box]:
    """The first ``most`` that are ``apart_m`` from all before them."""
    kept: list[Box] = []
    for one in boxes:
        if all(one.pose.distance_to(other.pose) >= apart_m for other in kept):
            kept.append(one)
        if len(kept) == most:
            break
    return kept


def with_box(known: PointMap, one: Box) -> PointMap:
    """The map of the same place with the box in it, as a robot would have mapped it: its front and
    sides are seen, and what it hides is not. The map itself stays as it is; the copy has no rays of
    the box, and is good for localization only."""
    after = PointMap(known.params, known.name)
    after.path, after.noises_m, after.rays = known.path, known.noises_m, known.rays
    after.reframings, after.imported, after.layers = known.reframings, known.imported, known.layers
    half = 0.5 * np.array([one.shape.width_m, one.shape.depth_m])

    def is_hidden(points_m: Array) -> NDArray[np.bool_]:
        x, y = (one.pose.inverse() @ points_m).T
        behind = (y > -half[1] - _HIDDEN_M) & (y < half[1])
        return np.asarray((np.abs(x) < half[0]) & behind)

    for grid, copied in ((known.walls, after.walls), (known.space, after.space)):
        kept = ~is_hidden(grid.centres())
        copied.keys, copied.sums = grid.keys[kept], grid.sums[kept]
    points_m, normals = _front_and_sides(one, 0.5 * known.walls.cell_m)
    double = 2.0 * np.arctan2(normals[:, 1], normals[:, 0])
    each = np.ones(len(points_m))
    values = np.column_stack([each, points_m, np.cos(double), np.sin(double), normals, each])
    after.walls.add(after.walls.keys_of(points_m), _LOOKS * values)
    ends = np.unique(after.space.keys_of(points_m))
    rows = after.space.find(ends)
    after.space.sums[rows[rows >= 0]] = 0.0
    after.space.add(ends, np.column_stack([np.zeros(len(ends)), np.full(len(ends), _LOOKS)]))
    after.revision = 1
    return after


def _front_and_sides(one: Box, spacing_m: float) -> tuple[Array, Array]:
    """Points (n, 2) of a box that can be seen, and their normals (n, 2), in the map."""
    x, y = 0.5 * one.shape.width_m, 0.5 * one.shape.depth_m
    points, normals = [], []
    for begin, end, normal in (
        ((-x, -y), (-x, y), (-1.0, 0.0)),
        ((-x, y), (x, y), (0.0, 1.0)),
        ((x, y), (x, -y), (1.0, 0.0)),
    ):
        count = int(math.dist(begin, end) / spacing_m) + 2
        points.append(np.linspace(begin, end, count))
        normals.append(np.tile(normal, (count, 1)))
    return one.pose @ np.concatenate(points), np.concatenate(normals) @ one.pose.rotation.T
