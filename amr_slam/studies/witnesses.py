"""One decision from one scan, and from a second one a step further on: who would be believed.

:func:`right_places` and :func:`nowhere` give the records on which acceptance thresholds are chosen
(on worlds of their own) and on which :mod:`amr_slam.studies.negatives` judges them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from amr_slam.clouds import Cloud
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.simulation import ScannerModel, blocked
from amr_slam.studies.scenes import ROBOT_RADIUS_M, S300, Scene, is_right, noisy_cloud
from amr_slam.studies.trials import Circumstances, Trial, localize

UNMAPPED: Final = 0.3
"""A robot that sees less of the mapped walls than this stands where the map knows nothing."""

# What the wheels miss of a step: share of the way, and heading in rad.
_WHEELS_SHARE = 0.02
_WHEELS_RAD = math.radians(1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Witnesses:
    """Two scans, 0.6 to 1 m apart, each localized for itself."""

    first: Trial
    second: Trial
    agree: bool
    """The two best places are one and the same under the wheels' motion (0.25 m, 5 degrees)."""

    @property
    def confirmed(self) -> bool:
        """Accepted twice, and in agreement."""
        return self.first.accepted and self.second.accepted and self.agree

    @property
    def wrongly_confirmed(self) -> bool:
        return self.confirmed and not self.second.right


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hunt:
    """A map to localize in, and the scene in which the robot truly stands."""

    known: PointMap
    model: ScannerModel
    params: SlamParams
    scene: Scene
    in_map: bool
    """The map's frame is the scene's world; False: the map is of another world."""

    def witnesses(self, pose: Pose2, under: Circumstances, rng: np.random.Generator) -> Witnesses:
        """Localize at ``pose`` and a step further; the wheels tell the step but for their noise."""
        further = step_from(self.scene, pose, rng)
        first = self._localize(pose, under, rng)
        second = self._localize(further, under, rng)
        moved = pose.inverse() @ further
        way_m = math.hypot(moved.x_m, moved.y_m)
        noise = rng.normal(0.0, [_WHEELS_SHARE * way_m, _WHEELS_SHARE * way_m, _WHEELS_RAD])
        agree = (
            first.pose is not None
            and second.pose is not None
            and is_right(second.pose, first.pose @ moved @ Pose2.from_array(noise))
        )
        return Witnesses(first=first, second=second, agree=agree)

    def _localize(self, pose: Pose2, under: Circumstances, rng: np.random.Generator) -> Trial:
        cloud = disturbed(self.scene, self.model, pose, under, rng, self.params)
        return localize(cloud, self.known, self.params, pose if self.in_map else None, under)


def disturbed(
    scene: Scene,
    model: ScannerModel,
    pose: Pose2,
    under: Circumstances,
    rng: np.random.Generator,
    params: SlamParams,
) -> Cloud:
    """The cloud seen from ``pose`` with as many beams blocked as the circumstances say."""
    scan = scene.scan(replace(model, sigma_xy_m=0.0), pose, rng)
    if under.blocked > 0.0:
        scan = blocked(scan, rng, under.blocked)
    return noisy_cloud(scan, model, rng, params.clouds)


def right_places(
    scene: Scene,
    known: PointMap,
    model: ScannerModel,
    params: SlamParams,
    under: Circumstances,
    count: int,
    rng: np.random.Generator,
) -> Iterator[Witnesses]:
    """``count`` covered poses of the mapped world itself."""
    hunt = Hunt(known=known, model=model, params=params, scene=scene, in_map=True)
    for pose in scene.poses(count, rng):
        yield hunt.witnesses(pose, under, rng)


def nowhere(
    other: Scene,
    known: PointMap,
    model: ScannerModel,
    params: SlamParams,
    under: Circumstances,
    count: int,
    rng: np.random.Generator,
) -> Iterator[Witnesses]:
    """``count`` free poses of a world that is not the map's."""
    hunt = Hunt(known=known, model=model, params=params, scene=other, in_map=False)
    for pose in other.poses(count, rng, covered=False):
        yield hunt.witnesses(pose, replace(under, negative=True), rng)


def beyond(
    scene: Scene,
    model: ScannerModel,
    params: SlamParams,
    under: Circumstances,
    count: int,
    rng: np.random.Generator,
) -> Iterator[Witnesses]:
    """``count`` poses of the half of a hall of which the map knows nothing."""
    half, cut_x = half_of(scene)
    known = half_map(half, cut_x, model, params, rng)
    hunt = Hunt(known=known, model=model, params=params, scene=half, in_map=True)
    for pose in unmapped_poses(half, cut_x, count, rng):
        yield hunt.witnesses(pose, replace(under, negative=True), rng)


def unmapped_poses(half: Scene, cut_x: float, count: int, rng: np.random.Generator) -> list[Pose2]:
    """Free poses beyond ``cut_x`` that see hardly any mapped wall; fewer than ``count`` where the
    mapped half is hardly ever out of sight."""
    free = half.poses(20 * count, rng, covered=False)
    far = (pose for pose in free if pose.x_m > cut_x and half.coverage(pose) < UNMAPPED)
    return list(itertools.islice(far, count))


def half_of(scene: Scene) -> tuple[Scene, float]:
    """The scene with its mapping cut off at the median x of the mapping poses, and that x."""
    cut_x = float(np.median([pose.x_m for pose in scene.mapping]))
    ends = np.asarray(scene.seen.data)
    half = replace(
        scene,
        mapping=tuple(pose for pose in scene.mapping if pose.x_m < cut_x),
        seen=cKDTree(ends[ends[:, 0] < cut_x]),
    )
    return half, cut_x


def half_map(
    half: Scene,
    cut_x: float,
    model: ScannerModel,
    params: SlamParams,
    rng: np.random.Generator,
) -> PointMap:
    """The map of a half: beams that end beyond ``cut_x`` are no measurement."""
    known = PointMap(params.map)
    for pose in half.mapping:
        scan = half.scan(replace(model, sigma_xy_m=0.0), pose, rng)
        bearing = (pose @ model.base_from_lidar).theta_rad + model.angles_rad
        with np.errstate(invalid="ignore"):
            inside = pose.x_m + scan.ranges_m * np.cos(bearing) < cut_x
        scan = replace(scan, ranges_m=np.where(inside, scan.ranges_m, np.nan))
        known.insert(noisy_cloud(scan, model, rng, params.clouds), pose)
    return known


def step_from(scene: Scene, pose: Pose2, rng: np.random.Generator) -> Pose2:
    """Where the robot stands 0.6 to 1 m further; turned on the spot where there is no room."""
    for _ in range(30):
        way_m, bearing = rng.uniform(0.6, 1.0), rng.uniform(-math.pi, math.pi)
        further = pose @ Pose2(
            way_m * math.cos(bearing), way_m * math.sin(bearing), rng.uniform(-0.6, 0.6)
        )
        way = np.linspace(pose.translation, further.translation, 5)
        if scene.world.clearance(way).min() >= ROBOT_RADIUS_M:
            return further
    return pose @ Pose2(0.0, 0.0, rng.uniform(0.3, 0.6))


def evidence_records(
    scene: Scene,
    other: Scene,
    sigma_m: float,
    params: SlamParams,
    count: int,
    *,
    clutter: float = 0.25,
    scanner: ScannerModel = S300,
) -> list[Witnesses]:
    """``count`` pairs of each kind for one mapped world: right places clean and cluttered, scans
    of ``other`` clean and cluttered, and of the unmapped half."""
    rng = np.random.default_rng((scene.world.seed, round(1e3 * sigma_m)))
    model = replace(scanner, sigma_xy_m=sigma_m)
    known = scene.map_at_truth(model, params)
    clean = Circumstances(kind=scene.kind, seed=scene.world.seed, sigma_m=sigma_m)
    found: list[Witnesses] = []
    for under in (clean, replace(clean, blocked=clutter)):
        found += right_places(scene, known, model, params, under, count, rng)
        found += nowhere(other, known, model, params, under, count, rng)
        found += beyond(scene, model, params, under, count, rng)
    return found
