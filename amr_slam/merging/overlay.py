"""One map laid on another: brought exactly there, and what speaks for and against it.

Judged is each scan of either map where the other one knows something, at the pose to which it
registers: maps bend by some centimetres, and a wall that lies beside itself contradicts nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from amr_slam.evidence import Hypothesis, assess
from amr_slam.geometry import Array, Pose2, inverse_matrix, wrap_angle
from amr_slam.graph.posegraph import Edge, optimize
from amr_slam.map import PointMap
from amr_slam.merging.scans import Rows, cloud_of, kept_rows, path_poses
from amr_slam.params import SlamParams
from amr_slam.registration import icp
from amr_slam.registration.alignment import Alignment
from amr_slam.registration.icp import Prior
from amr_slam.slam import cannot_register

_FLOOR: Final = np.diag([0.03**2, 0.03**2, 0.006**2])
"""Covariance that a scan has at least in the other map: both bend."""
_PRIOR: Final = np.diag([0.15**2, 0.15**2, 0.03**2])
"""How far off a scan may be where the other scans say that it is."""
_LEAST_KNOWN: Final = 0.3
"""Of a scan: less lies where the other map knows anything, and it is no witness."""
_NEAR_M: Final = 3.0
"""A scan taken this near to where the other map was made from may see what it knows."""
_ROUNDS: Final = 3
_NOTHING: Final = 1e-4 * np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Laid:
    """A scan of one map, registered in the other."""

    row: int
    """Of the path of its own map."""
    found: Hypothesis
    """How it fits in the other one."""
    covariance: Array
    """(3, 3) of that pose, read-only: of the points alone, with what maps bend."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Overlay:
    """``other`` laid on ``known``."""

    known_from_other: Pose2
    there: tuple[Laid, ...]
    """Scans of ``other``, in ``known``."""
    back: tuple[Laid, ...]
    """Scans of ``known``, in ``other``."""
    common_m2: float
    """Floor that both have seen free."""
    rms_m: float
    """Of the distances between where scans are found and where the rigid motion has them."""

    @property
    def fits(self) -> float:
        """Share of what scans of one map see in places known to the other that it has, too."""
        laid = (*self.there, *self.back)
        known = sum(one.found.known for one in laid)
        return sum(one.found.known * one.found.inliers for one in laid) / max(known, 1e-9)

    @property
    def contradicts(self) -> float:
        """Share of it that stands on floor which the other map has seen free."""
        laid = (*self.there, *self.back)
        known = sum(one.found.known for one in laid)
        return sum(one.found.conflict for one in laid) / max(known, 1e-9)

    @property
    def evidence(self) -> float:
        """What fits less twice what contradicts, in whole scans: what speaks for it in all."""
        return sum(
            one.found.known * one.found.inliers - 2.0 * one.found.conflict
            for one in (*self.there, *self.back)
        )


def lay(
    known: PointMap, other: PointMap, rough: Pose2, most: int, params: SlamParams
) -> Overlay | None:
    """Bring ``other`` onto ``known`` from ``rough`` (known_from_other), by at most ``most`` of its
    scans. None where no scan of it finds a hold there."""
    way = rough
    for _ in range(_ROUNDS):
        there = registered(known, other, way, most, params)
        if not there:
            return None
        before, way = way, _rigid(other, there, way)
        if before.distance_to(way) < 0.005 and abs((before.inverse() @ way).theta_rad) < 1e-3:
            break
    back = registered(other, known, way.inverse(), most, params)
    poses = path_poses(other)
    expected = way @ poses[[one.row for one in there], :2]
    off = expected - np.array([one.found.pose.translation for one in there])
    return Overlay(
        known_from_other=way,
        there=tuple(there),
        back=tuple(back),
        common_m2=common_m2(known, other, way),
        rms_m=float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
    )


def registered(
    known: PointMap, other: PointMap, way: Pose2, most: int, params: SlamParams
) -> list[Laid]:
    """Scans of ``other``, evenly along its way, in ``known``, near where ``way`` puts them."""
    target = known.target()
    laid = []
    for row in _overlapping(known, other, way, most).tolist():
        cloud = cloud_of(other, row)
        expected = way @ other.path[row][1]
        if cannot_register(cloud, target):
            continue
        first = assess(cloud, target, _at(expected), params)
        if first.known < _LEAST_KNOWN:
            continue
        prior = Prior(target_from_source=expected, information=inverse_matrix(_PRIOR))
        alignment = icp.align(cloud, target, expected, params.icp, prior)
        found = assess(cloud, target, alignment, params)
        if found.known < _LEAST_KNOWN:
            continue
        covariance = inverse_matrix(alignment.information + _NOTHING) + _FLOOR
        laid.append(Laid(row=row, found=found, covariance=covariance))
    return laid


def common_m2(known: PointMap, other: PointMap, way: Pose2) -> float:
    """Floor area that both have seen free."""
    there = other.surfaces().free_m
    space = known.space
    row = space.find(np.unique(space.keys_of(way @ np.asarray(there, dtype=np.float64))))
    row = row[row >= 0]
    free = space.sums[row, 0] > space.sums[row, 1]
    return float(free.sum()) * space.cell_m**2


def _overlapping(known: PointMap, other: PointMap, way: Pose2, most: int) -> Rows:
    """Rows of scans that were taken where ``known`` has been looked at."""
    rows = kept_rows(other)
    places = way @ path_poses(other)[rows, :2]
    floor = known.surfaces().free_m
    if not len(rows) or not len(floor):
        return rows[:0]
    away_m = scipy.spatial.cKDTree(floor).query(places, distance_upper_bound=_NEAR_M)[0]
    rows = np.asarray(rows[np.isfinite(np.asarray(away_m))])
    if len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).round().astype(np.intp)]
    return np.asarray(rows)


def _at(pose: Pose2) -> Alignment:
    return Alignment(
        target_from_source=pose,
        information=np.zeros((3, 3)),
        converged=True,
        iterations=0,
        inliers=0.0,
        rmse_m=0.0,
    )


def _rigid(other: PointMap, there: Sequence[Laid], way: Pose2) -> Pose2:
    """The motion that agrees best with where these scans are found, whoever is wrong of them."""
    edges = []
    for one in there:
        found, pose = one.found.pose, other.path[one.row][1]
        arm = found.translation - way.translation
        by_way = np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]], [0.0, 0.0, 1.0]])
        information = by_way.T @ inverse_matrix(one.covariance) @ by_way
        delta = found @ pose.inverse()
        edges.append(Edge(start=0, end=1, delta=delta, information=information, loop=True))
    poses = np.array([[0.0, 0.0, 0.0], way.as_array()])
    x_m, y_m, theta_rad = optimize(poses, edges)[1]
    return Pose2(float(x_m), float(y_m), float(wrap_angle(theta_rad)))
