"""Other people's registration methods and ours, made to answer the same question.

Each method prepares a map once, then finds one scan after the other. The peers are optional
(dependency group ``peers``) and loaded when they are asked for. They work in three dimensions:
the plane is their z = 0.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from amr_slam.clouds import Cloud, cloud_from_scan
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.registration import icp
from amr_slam.samples import Scan
from amr_slam.slam import Verdict, slam_absolute
from amr_slam.slam_request import SlamRequest

START_M: Final = 0.15
START_RAD: Final = math.radians(5.0)

_PARAMS: Final = SlamParams()
ITERATIONS: Final = 50
# Heights of the copies in m: a plane has no volume, and normals and histograms need some.
_THIN_WALL: Final = (-0.05, 0.0, 0.05)
_HIGH_WALL: Final = (0.0, 0.3, 0.9)
_FPFH_VOXEL_M: Final = 0.2
_FPFH_RADIUS_M: Final = 2.5
_KISS_VOXEL_M: Final = 0.3
_KISS_WALL: Final = (0.0, 0.3, 0.6, 0.9, 1.2)
_KISS_INLIERS: Final = 5
_CLAIMED_FITNESS: Final = 0.9
_CPD_POINTS: Final = 400


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Query:
    """One scan to find."""

    scan: Scan
    cloud: Cloud
    start: Pose2
    """Where a local method begins: START_M and START_RAD off the truth."""
    truth: Pose2


@dataclass(frozen=True, slots=True)
class Found:
    """What a method says of one query."""

    pose: Pose2
    claimed: bool = True
    """By the method's own criterion of success, where it has one."""


Find = Callable[[Query], Found]


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One contestant."""

    name: str
    package: str
    """Import name of what it comes from."""
    setting: str
    """In words, for the page."""
    prepare: Callable[[PointMap], Find]
    """Takes the map (not timed) and returns what is timed."""
    every: int = 1
    """Only each so many-th query: for the slow."""


def version(package: str) -> str | None:
    """Of an installed package that can be loaded, else None."""
    try:
        importlib.import_module(package)
        return importlib.metadata.version(package)
    except ImportError:  # PackageNotFoundError is one, too; so is a missing system library
        return None


# -- ours ----------------------------------------------------------------------------------


def _our_cloud(query: Query) -> Cloud:
    """Made anew, to count its time: it computes the normals that the ICP needs of the source."""
    return cloud_from_scan(query.scan, Pose2.identity(), _PARAMS.clouds)


def _given_cloud(query: Query) -> Cloud:
    return query.cloud


def _our_icp(cloud_of: Callable[[Query], Cloud]) -> Callable[[PointMap], Find]:
    def prepare(known: PointMap) -> Find:
        target = known.target()

        def find(query: Query) -> Found:
            found = icp.align(cloud_of(query), target, query.start, _PARAMS.icp)
            return Found(found.target_from_source, found.converged)

        return find

    return prepare


def _our_relative(known: PointMap) -> Find:
    engine = SlamEngine(_PARAMS, known, "localization")
    covariance = np.diag([0.5 * START_M**2, 0.5 * START_M**2, START_RAD**2])

    def find(query: Query) -> Found:
        request = SlamRequest(
            cloud=_our_cloud(query), map_from_base=query.start, covariance=covariance
        )
        fix = engine.update(request).fix
        return Found(query.start, claimed=False) if fix is None else Found(fix.map_from_base)

    return find


def _our_absolute(known: PointMap) -> Find:
    def find(query: Query) -> Found:
        answer = slam_absolute(_our_cloud(query), known, _PARAMS)
        if answer.best is None:
            return Found(Pose2.identity(), claimed=False)
        return Found(answer.best.pose, answer.verdict is Verdict.ACCEPTED)

    return find


# -- peers ---------------------------------------------------------------------------------


def _stacked(points_m: Array, heights_m: Sequence[float] = (0.0,)) -> Array:
    """(n * copies, 3): points (n, 2) of the plane at each height."""
    rows = [np.column_stack([points_m, np.full(len(points_m), z)]) for z in heights_m]
    return np.concatenate(rows)


def _matrix(pose: Pose2) -> Array:
    matrix = np.eye(4)
    matrix[:2, :2] = pose.rotation
    matrix[:2, 3] = pose.translation
    return matrix


def _pose(matrix: Array) -> Pose2:
    """The part of a motion in space (4, 4) that is in the plane; what is no number is the origin:
    an answer, but a wrong one."""
    pose = Pose2(matrix[0, 3], matrix[1, 3], math.atan2(matrix[1, 0], matrix[0, 0]))
    return pose if pose.is_finite() else Pose2.identity()


def _small_gicp(kind: str) -> Callable[[PointMap], Find]:
    def prepare(known: PointMap) -> Find:
        peer: Any = importlib.import_module("small_gicp")
        heights = (0.0,) if kind == "ICP" else _THIN_WALL
        target = peer.PointCloud(_stacked(known.target().points_m, heights))
        tree = peer.KdTree(target)
        if kind != "ICP":
            peer.estimate_normals_covariances(target, tree, num_neighbors=15)

        def find(query: Query) -> Found:
            source = peer.PointCloud(_stacked(query.cloud.points_m))
            if kind == "GICP":
                peer.estimate_normals_covariances(source, num_neighbors=15)
            result = peer.align(
                target,
                source,
                tree,
                _matrix(query.start),
                registration_type=kind,
                max_iterations=ITERATIONS,
                num_threads=1,
            )
            return Found(_pose(result.T_target_source), bool(result.converged))

        return find

    return prepare


def _open3d_cloud(points: Array, normals: Array | None = None) -> Any:
    peer: Any = importlib.import_module("open3d")
    cloud = peer.geometry.PointCloud(peer.utility.Vector3dVector(points))
    if normals is not None:
        cloud.normals = peer.utility.Vector3dVector(normals)
    return cloud


def _open3d_refine(source: Any, target: Any, start: Array, metric: str = "Point") -> Any:
    peer: Any = importlib.import_module("open3d").pipelines.registration
    estimation = getattr(peer, f"TransformationEstimationPointTo{metric}")()
    criteria = peer.ICPConvergenceCriteria(max_iteration=ITERATIONS)
    return peer.registration_icp(source, target, _PARAMS.icp.reach_m, start, estimation, criteria)


def _open3d_icp(metric: str) -> Callable[[PointMap], Find]:
    def prepare(known: PointMap) -> Find:
        walls = known.target()
        straight = np.any(walls.normals != 0.0, axis=1)
        target = _open3d_cloud(
            _stacked(walls.points_m[straight]), _stacked(walls.normals[straight])
        )

        def find(query: Query) -> Found:
            source = _open3d_cloud(_stacked(query.cloud.points_m))
            result = _open3d_refine(source, target, _matrix(query.start), metric)
            return Found(_pose(result.transformation))

        return find

    return prepare


def _open3d_global(known: PointMap) -> Find:
    peer: Any = importlib.import_module("open3d")
    methods = peer.pipelines.registration

    def features(points_m: Array, normals: Array) -> tuple[Any, Any]:
        straight = np.any(normals != 0.0, axis=1)
        upright = np.tile(_stacked(normals[straight]), (len(_HIGH_WALL), 1))
        cloud = _open3d_cloud(_stacked(points_m[straight], _HIGH_WALL), upright)
        cloud = cloud.voxel_down_sample(_FPFH_VOXEL_M)
        around = peer.geometry.KDTreeSearchParamRadius(_FPFH_RADIUS_M)
        return cloud, methods.compute_fpfh_feature(cloud, around)

    walls = known.target()
    flat = _open3d_cloud(_stacked(walls.points_m))
    target, target_features = features(walls.points_m, walls.normals)
    reach_m = 1.5 * _FPFH_VOXEL_M
    peer.utility.random.seed(0)

    def find(query: Query) -> Found:
        source, source_features = features(query.cloud.points_m, query.cloud.normals)
        rough = methods.registration_ransac_based_on_feature_matching(
            source, target, source_features, target_features, False, reach_m,
            methods.TransformationEstimationPointToPoint(), 3,
            [
                methods.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                methods.CorrespondenceCheckerBasedOnDistance(reach_m),
            ],
            methods.RANSACConvergenceCriteria(100_000, 0.999),
        )  # fmt: skip
        plane = _open3d_cloud(_stacked(query.cloud.points_m))
        exact = _open3d_refine(plane, flat, rough.transformation)
        return Found(_pose(exact.transformation), exact.fitness >= _CLAIMED_FITNESS)

    return find


def _rows(points_m: Array) -> list[Any]:
    """As KISS-Matcher takes them."""
    return list(_stacked(points_m, _KISS_WALL).astype(np.float32))


def _kiss_global(known: PointMap) -> Find:
    peer: Any = importlib.import_module("kiss_matcher")
    config = peer.KISSMatcherConfig(_KISS_VOXEL_M, use_quatro=True)
    target = _rows(known.target().points_m)
    refine = _our_icp(_given_cloud)(known)

    def find(query: Query) -> Found:
        matcher = peer.KISSMatcher(config)
        answer = matcher.estimate(_rows(query.cloud.points_m), target)
        if not answer.valid:
            return Found(Pose2.identity(), claimed=False)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = answer.rotation, answer.translation
        rough = Query(scan=query.scan, cloud=query.cloud, start=_pose(matrix), truth=query.truth)
        claimed = matcher.get_num_final_inliers() >= _KISS_INLIERS
        return Found(refine(rough).pose, claimed)

    return find


def _pycpd(known: PointMap) -> Find:
    peer: Any = importlib.import_module("pycpd")
    # Without a first width it takes that of both clouds: part of a room then slides to its middle.
    width_m2 = (2.0 * START_M) ** 2
    target = _some(known.target().points_m)

    def find(query: Query) -> Found:
        # Its motion begins at the identity: the source is brought to the start before.
        source = query.start @ _some(query.cloud.points_m)
        method = peer.RigidRegistration(
            X=target, Y=source, scale=False, w=0.3, sigma2=width_m2, max_iterations=ITERATIONS
        )
        method.register()
        # Row vectors: moved = source @ R + t.
        turn = math.atan2(method.R[0, 1], method.R[0, 0])
        return Found(Pose2(method.t[..., 0].item(), method.t[..., 1].item(), turn) @ query.start)

    return find


def _some(points_m: Array) -> Array:
    """At most _CPD_POINTS of points (n, 2), evenly chosen."""
    count = min(len(points_m), _CPD_POINTS)
    return points_m[np.linspace(0, len(points_m) - 1, count).astype(np.int64)]


_POINTS_ALONE: Final = "points at z = 0"

LOCAL: Final = (
    Method(
        name="ours: ICP alone",
        package="amr_slam",
        setting="`icp.align`, one start; `cloud_from_scan`, which computes normals, not counted",
        prepare=_our_icp(_given_cloud),
    ),
    Method(
        name="ours: cloud and ICP",
        package="amr_slam",
        setting="the same, and `cloud_from_scan` counted: where the peers' times begin, points in "
        "the base frame, lies between the two",
        prepare=_our_icp(_our_cloud),
    ),
    Method(
        name="ours: whole relative update",
        package="amr_slam",
        setting="`SlamEngine.update` with a prior, its ladder and `cloud_from_scan` included",
        prepare=_our_relative,
    ),
    Method(
        name="small_gicp ICP", package="small_gicp", setting=_POINTS_ALONE,
        prepare=_small_gicp("ICP"),
    ),
    Method(
        name="small_gicp PLANE_ICP",
        package="small_gicp",
        setting="three copies of the map 5 cm above each other, so that its 15-neighbour normals "
        "lie in the plane; scan at z = 0",
        prepare=_small_gicp("PLANE_ICP"),
    ),
    Method(
        name="small_gicp GICP",
        package="small_gicp",
        setting="the same map. With copies of the scan as well it was better without noise "
        "(0.2 instead of 1.4 mm) and worse with 0.3 m (157 instead of 74 mm)",
        prepare=_small_gicp("GICP"),
    ),
    Method(
        name="Open3D point-to-point", package="open3d", setting=_POINTS_ALONE,
        prepare=_open3d_icp("Point"),
    ),
    Method(
        name="Open3D point-to-plane",
        package="open3d",
        setting="points at z = 0, with the normals of our map",
        prepare=_open3d_icp("Plane"),
    ),
    Method(
        name="pycpd rigid",
        package="pycpd",
        setting=f"in the plane, {_CPD_POINTS} points of each, outlier weight 0.3, first "
        "width 0.3 m; each fifth scan",
        prepare=_pycpd,
        every=5,
    ),
)  # fmt: skip
"""From a start 0.15 m and 5 degrees off."""

GLOBAL: Final = (
    Method(
        name="ours: absolute strategy",
        package="amr_slam",
        setting="`slam_absolute` and `cloud_from_scan`; claims what it accepts",
        prepare=_our_absolute,
    ),
    Method(
        name="Open3D FPFH + RANSAC, ICP",
        package="open3d",
        setting="copies at 0, 0.3 and 0.9 m with our normals, voxels of 0.2 m, features of 2.5 m, "
        "100,000 iterations; then point-to-point ICP at z = 0. It reports a fitness and no "
        f"verdict: {_CLAIMED_FITNESS:g} after ICP is taken for a claim",
        prepare=_open3d_global,
    ),
    Method(
        name="KISS-Matcher, ICP",
        package="kiss_matcher",
        setting=f"five copies 0.3 m above each other, voxels of {_KISS_VOXEL_M:g} m, yaw-only "
        f"solver (Quatro), other settings as they come; then our ICP. Claims with {_KISS_INLIERS} "
        "final inliers, as its example does. Its features of the map cannot be kept and count",
        prepare=_kiss_global,
    ),
)
"""From nowhere."""
