"""SLAM from scratch: a simulated robot drives a tour once, the whole localizer maps it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.engine import SlamEngine
from amr_slam.evaluation import absolute_trajectory_error, align_se2, poses_at
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.recording import Trajectory
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Vehicle,
    World,
    plan_tour,
)
from amr_slam.slam_request import SlamResult

WHEEL_ERROR: Final = 0.005
"""Standard deviation of the wheels' radii and of the track, as a share: the odometry that
believes in the nominal ones is off by half a metre to a metre after the tour."""

# Counts are sums: every fifth of 50 a second tells the same motion at a fifth of the time.
_WHEELS_KEPT = 5
_ODOMETRY = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """Once round the tour: about 85 scans at 0.5 Hz and 0.3 m/s."""

    world_from_map: Pose2
    """The start pose."""
    model: ScannerModel
    samples: tuple[Scan | WheelSample, ...]
    truth: Trajectory
    """map_from_base at each wheel sample."""

    def wheels_alone_m(self) -> float:
        """ATE of the odometry without any scan."""
        wheels = [sample for sample in self.samples if isinstance(sample, WheelSample)]
        pose = Pose2.identity()
        path = [(wheels[0].stamp_ns, pose.as_array())]
        for before, after in itertools.pairwise(wheels):
            pose = pose @ _ODOMETRY.motion(before, after).delta
            path.append((after.stamp_ns, pose.as_array()))
        return _ate_m(_trajectory(path), self.truth)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """What the localizer made of a drive."""

    known: PointMap
    """In the frame of the start pose."""
    results: tuple[SlamResult, ...]
    path: Trajectory
    """map_from_base at each scan as the fusion had it once the scan was registered, moved along
    with the map by the loops that were closed later."""
    map_from_start: Pose2
    """How the map's frame lies to that of the true start pose, by all of the path."""
    ate_m: float
    """SE2-aligned root mean square distance of ``path``."""
    online_ate_m: float
    """The same of the poses published meanwhile, at each wheel sample."""


def drive(world: World, model: ScannerModel, seed: int) -> Drive:
    """The robot follows the planned tour by the truth; its wheels differ from their nominal
    measures and slip. ``model`` is the one scanner."""
    tour = plan_tour(world)
    errors = np.random.default_rng((world.seed, seed)).normal(0.0, WHEEL_ERROR, 3)
    robot = SimulatedRobot(
        world=world,
        world_from_map=tour.world_from_map,
        scanners=(replace(model, sweep_s=0.03),),
        vehicle=Vehicle(
            left_radius_error=errors[0], right_radius_error=errors[1], track_error=errors[2]
        ),
        seed=seed,
    )
    follower = PathFollower(tour.path_in_map_m)
    samples: list[Scan | WheelSample] = []
    truth: list[tuple[int, Array]] = [(robot.stamp_ns, robot.map_from_base.as_array())]
    wheels = 0
    while follower.laps < 1.0:
        for sample in robot.advance(*follower.steer(robot.map_from_base)):
            wheels += isinstance(sample, WheelSample)
            if isinstance(sample, Scan) or wheels % _WHEELS_KEPT == 1:
                samples.append(sample)
        truth.append((robot.stamp_ns, robot.map_from_base.as_array()))
    return Drive(
        world_from_map=tour.world_from_map,
        model=model,
        samples=tuple(samples),
        truth=_trajectory(truth),
    )


def survey(driven: Drive, params: SlamParams) -> Survey:
    """Map a drive from scratch with the product's localizer and engine, in mapping mode."""
    mounting = Mounting(base_from_lidar=driven.model.base_from_lidar)
    localizer = Localizer(
        LocalizerParams(),
        FilterParams(),
        params.clouds,
        _ODOMETRY,
        {driven.model.name: mounting},
        "mapping",
    )
    engine = SlamEngine(params, PointMap(params.map), "mapping")
    results: list[SlamResult] = []
    path: list[tuple[int, tuple[int, Pose2]]] = []
    online: list[tuple[int, Array]] = []
    for sample in driven.samples:
        localizer.handle(sample)
        estimate = localizer.estimate(sample.stamp_ns)
        if estimate is not None and isinstance(sample, WheelSample):
            online.append((sample.stamp_ns, estimate.map_from_base.as_array()))
        request = localizer.take_request()
        if request is None:
            continue
        results.append(engine.update(request))
        localizer.handle(results[-1])
        stamp_ns = results[-1].stamp_ns
        fused = localizer.filter.pose_at(stamp_ns) if localizer.filter else None
        if fused is not None:
            path.append((stamp_ns, engine.anchored(fused[0])))
    engine.settle()
    seen = _trajectory([(stamp, engine.unanchored(*pose).as_array()) for stamp, pose in path])
    true, valid = poses_at(driven.truth, seen.stamps_ns)
    return Survey(
        known=engine.map,
        results=tuple(results),
        path=seen,
        map_from_start=align_se2(true[valid], seen.poses[valid]),
        ate_m=_ate_m(seen, driven.truth),
        online_ate_m=_ate_m(_trajectory(online), driven.truth),
    )


def _trajectory(poses: Sequence[tuple[int, Array]]) -> Trajectory:
    return Trajectory(
        stamps_ns=np.array([stamp for stamp, _ in poses], dtype=np.int64),
        poses=np.array([pose for _, pose in poses]).reshape(-1, 3),
    )


def _ate_m(estimate: Trajectory, truth: Trajectory) -> float:
    poses, valid = poses_at(truth, estimate.stamps_ns)
    reference = Trajectory(stamps_ns=estimate.stamps_ns[valid], poses=poses[valid])
    return absolute_trajectory_error(estimate, reference).position_m.rms
