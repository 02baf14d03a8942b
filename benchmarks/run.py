"""What the parts cost, side by side: prints Markdown tables and asserts nothing.

One simulated laboratory of 200 m2, fixed seeds. All times are the process's own (processor time):
a machine that is busy otherwise changes them little. Example: python benchmarks/run.py
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, ParamSpec, TypeVar

import numpy as np

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.engine import SlamEngine
from amr_slam.fusion import FilterParams, PoseFilter
from amr_slam.geometry import Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import Preset, SlamParams, preset
from amr_slam.replay import replay
from amr_slam.samples import Motion, Scan, SlamPose, WheelSample
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Tour,
    Vehicle,
    World,
    laboratory,
    opposite_scanners,
    plan_tour,
    take_scan,
)
from amr_slam.slam import Verdict, slam_absolute
from amr_slam.slam_request import SlamRequest

_Args = ParamSpec("_Args")
_T = TypeVar("_T")

SEED: Final = 7
S300: Final = ScannerModel(sigma_range_m=0.01)
OFFICE: Final = replace(S300, beams=181, angle_min_rad=-np.pi / 2, angle_step_rad=np.pi / 180)
PRESETS: Final[tuple[Preset, ...]] = ("default", "paper")
PRIOR_SIGMA: Final = np.array([0.1, 0.1, np.radians(3.0)])
"""How far the prior is off, per axis: what wheels gather in some metres."""
RIGHT_M: Final = 0.1
RIGHT_RAD: Final = np.radians(2.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """A laboratory, where scans are taken to map it, and where to localize in it."""

    world: World
    mapping: tuple[Pose2, ...]
    queries: tuple[Pose2, ...]

    @staticmethod
    def of(tour: Tour, world: World, queries: int) -> Scene:
        """A mapping scan every 0.6 m of the tour; queries between these, in any direction."""
        path = tour.path_m
        ahead = np.roll(path, -10, axis=0) - path
        headings = np.arctan2(ahead[:, 1], ahead[:, 0])
        rng = np.random.default_rng(SEED)
        rows = rng.choice(len(path), queries, replace=False)
        return Scene(
            world=world,
            mapping=tuple(
                Pose2.from_array((*path[i], headings[i])) for i in range(0, len(path), 12)
            ),
            queries=tuple(Pose2.from_array((*path[i], rng.uniform(-np.pi, np.pi))) for i in rows),
        )

    def clouds(
        self, model: ScannerModel, poses: Iterable[Pose2], params: CloudParams
    ) -> list[Cloud]:
        """One cloud a pose, from a standing robot."""
        rng = np.random.default_rng(SEED)
        return [
            cloud_from_scan(take_scan(model, self.world, pose, rng), Pose2.identity(), params)
            for pose in poses
        ]

    def map(self, model: ScannerModel, params: SlamParams) -> PointMap:
        """The laboratory as mapped from true poses."""
        grown = PointMap(params.map)
        clouds = self.clouds(model, self.mapping, params.clouds)
        for cloud, pose in zip(clouds, self.mapping, strict=True):
            grown.insert(cloud, pose)
        return grown


def main() -> int:
    """Measure and print, table by table."""
    begun_s = time.process_time()
    world = laboratory(SEED)
    scene = Scene.of(plan_tour(world), world, queries=60)
    machine = f"{platform.machine()}, {os.cpu_count()} processors"
    software = f"Python {platform.python_version()}, numpy {np.__version__}"
    print(f"{machine}, {software}; a laboratory mapped by {len(scene.mapping)} scans\n")
    _table(
        "Relative registration: one update near the expected pose",
        ("scan", "preset", "median ms", "p99 ms", "right", "wrong", "median error mm"),
        [relative(scene, m, name) for m in (OFFICE, S300) for name in PRESETS],
    )
    _table(
        "Absolute localization: one scan of 541 beams, anywhere in the map",
        ("preset", "first call ms", "median ms", "p99 ms", "right", "wrong", "median error mm"),
        [absolute(scene, name) for name in PRESETS],
    )
    _table(
        "Everything else",
        ("what", "median", "p99", "unit"),
        [*fusing(), *growing(scene), localizing()],
    )
    print(f"measured in {time.process_time() - begun_s:.0f} s")
    return 0


def relative(scene: Scene, model: ScannerModel, name: Preset) -> tuple[str, ...]:
    """The engine's whole update with a prior that is off by PRIOR_SIGMA, ladder included."""
    params = preset(name)
    known = scene.map(model, params)
    engine = SlamEngine(params, known, "localization")
    known.signatures(params.grid_m, params.robot_radius_m, params.rdnm)
    rng = np.random.default_rng(SEED)
    times: list[float] = []
    found: list[tuple[Pose2 | None, Pose2]] = []
    clouds = scene.clouds(model, scene.queries, params.clouds)
    for cloud, truth in zip(clouds, scene.queries, strict=True):
        request = SlamRequest(
            cloud=cloud,
            map_from_base=truth @ Pose2.from_array(rng.normal(0.0, PRIOR_SIGMA)),
            covariance=np.diag(PRIOR_SIGMA**2),
        )
        result = _timed(times, engine.update, request)
        found.append((None if result.fix is None else result.fix.map_from_base, truth))
    return (f"{model.beams} beams", name, *_quantiles(times), *_judged(found))


def absolute(scene: Scene, name: Preset) -> tuple[str, ...]:
    """Algorithm 2; the first call after a change of the map computes the places' signatures."""
    params = preset(name)
    first: list[float] = []
    clouds = scene.clouds(S300, scene.queries, params.clouds)
    for _ in range(3):
        known = scene.map(S300, params)
        _timed(first, slam_absolute, clouds[0], known, params)
    times: list[float] = []
    found: list[tuple[Pose2 | None, Pose2]] = []
    for cloud, truth in zip(clouds, scene.queries, strict=True):
        answer = _timed(times, slam_absolute, cloud, known, params)
        accepted = answer.verdict is Verdict.ACCEPTED and answer.best is not None
        found.append((answer.best.pose if accepted and answer.best else None, truth))
    return (name, _quantiles(first)[0], *_quantiles(times), *_judged(found))


def fusing() -> list[tuple[str, ...]]:
    """Wheels at 50 Hz for 60 s, each 2 s a fix that is 0.5 s old."""
    state = PoseFilter(FilterParams(), 0, Pose2.identity(), np.diag([1e-4, 1e-4, 1e-4]))
    step = Pose2(0.006, 0.0, 0.001)
    noise = np.diag([1e-6, 1e-8, 1e-6])
    truth = [Pose2.identity()]
    predicting: list[float] = []
    correcting: list[float] = []
    estimating: list[float] = []
    for k in range(1, 3001):
        motion = Motion(
            start_ns=(k - 1) * 20_000_000, end_ns=k * 20_000_000, delta=step, covariance=noise
        )
        truth.append(truth[-1] @ step)
        _timed(predicting, state.predict, motion)
        _timed(estimating, state.estimate_at, k * 20_000_000 + 5_000_000)
        if k % 100 == 0:
            fix = SlamPose(
                stamp_ns=(k - 25) * 20_000_000,
                map_from_base=truth[k - 25],
                covariance=np.diag([1e-4, 1e-4, 1e-5]),
            )
            _timed(correcting, state.correct, fix)
    return [
        ("filter: one wheel motion", *_quantiles(predicting, 1e6), "us"),
        ("filter: one delayed fix", *_quantiles(correcting, 1e6), "us"),
        ("filter: the pose to publish", *_quantiles(estimating, 1e6), "us"),
        ("filter: a fix 8 s old, four later ones absorbed anew", *_replaying(), "us"),
    ]


def _replaying() -> tuple[str, str]:
    """The costliest fix: the oldest that is still taken, before all others."""
    motions = [
        Motion(
            start_ns=(k - 1) * 20_000_000,
            end_ns=k * 20_000_000,
            delta=Pose2(0.006, 0.0, 0.001),
            covariance=np.diag([1e-6, 1e-8, 1e-6]),
        )
        for k in range(1, 501)
    ]
    covariance = np.diag([1e-4, 1e-4, 1e-5])
    took: list[float] = []
    for _ in range(40):
        state = PoseFilter(FilterParams(), 0, Pose2.identity(), np.diag([1e-4, 1e-4, 1e-4]))
        truth = {0: Pose2.identity()}
        for motion in motions:
            state.predict(motion)
            truth[motion.end_ns] = truth[motion.start_ns] @ motion.delta
        stamps = [k * 2_000_000_000 for k in (4, 3, 2, 5)] + [1_000_000_000]
        for stamp_ns in stamps:
            fix = SlamPose(stamp_ns=stamp_ns, map_from_base=truth[stamp_ns], covariance=covariance)
            _timed(took if stamp_ns == stamps[-1] else [], state.correct, fix)
    return _quantiles(took, 1e6)


def growing(scene: Scene) -> list[tuple[str, ...]]:
    """From two scans to one cloud, and from a cloud into the map."""
    rng = np.random.default_rng(SEED)
    models = opposite_scanners(S300)
    params = SlamParams()
    sweep = (Pose2(-0.004, 0.0, -0.005), Pose2(0.004, 0.0, 0.005))
    building: list[float] = []
    inserting: list[float] = []
    grown = PointMap(params.map)

    def build(scans: list[Scan]) -> Cloud:
        parts = zip(scans, models, strict=True)
        return merge(
            [
                (
                    cloud_from_scan(s, m.base_from_lidar, params.clouds, sweep=sweep),
                    Pose2.identity(),
                )
                for s, m in parts
            ]
        )

    for pose in scene.mapping:
        scans = [take_scan(model, scene.world, pose, rng) for model in models]
        cloud = _timed(building, build, scans)
        _timed(inserting, grown.insert, cloud, pose)
    return [
        ("two scans of 541 beams to one cloud, deskewed", *_quantiles(building), "ms"),
        ("that cloud into the map", *_quantiles(inserting), "ms"),
    ]


def localizing() -> tuple[str, ...]:
    """A minute of the demo's robot: wheels at 50 Hz, two scanners at 0.5 Hz, mapping."""
    world = laboratory(SEED)
    tour = plan_tour(world)
    robot = SimulatedRobot(
        world=world,
        world_from_map=tour.world_from_map,
        scanners=opposite_scanners(S300),
        vehicle=Vehicle(),
        seed=SEED,
    )
    follower = PathFollower(tour.path_in_map_m)
    samples: list[WheelSample | Scan] = []
    while robot.stamp_ns < 60e9:
        samples += robot.advance(*follower.steer(robot.map_from_base))
    params = SlamParams()
    localizer = Localizer(
        LocalizerParams(),
        FilterParams(),
        params.clouds,
        DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5),
        {m.name: Mounting(base_from_lidar=m.base_from_lidar) for m in opposite_scanners(S300)},
        "mapping",
    )
    begun_s = time.process_time()
    replay(samples, localizer, SlamEngine(params, PointMap(params.map), "mapping"))
    speed = 60.0 / (time.process_time() - begun_s)
    return ("the whole localizer on a minute of the demo", f"{speed:.0f}", "", "x real time")


def _timed(
    times_s: list[float], call: Callable[_Args, _T], *args: _Args.args, **options: _Args.kwargs
) -> _T:
    begun_s = time.process_time()
    result = call(*args, **options)
    times_s.append(time.process_time() - begun_s)
    return result


def _quantiles(times_s: list[float], per_second: float = 1e3) -> tuple[str, str]:
    """Median and p99."""
    median, p99 = per_second * np.quantile(times_s, (0.5, 0.99))
    return f"{median:.1f}", f"{p99:.1f}"


def _judged(found: list[tuple[Pose2 | None, Pose2]]) -> tuple[str, str, str]:
    """How many were right, how many wrong (the rest said that it did not know), and how exact the
    right ones were."""
    offsets = [truth.inverse() @ pose for pose, truth in found if pose is not None]
    errors = np.array(
        [(offset.distance_to(Pose2.identity()), offset.theta_rad) for offset in offsets]
    )
    errors = np.abs(errors.reshape(-1, 2))
    right = (errors[:, 0] <= RIGHT_M) & (errors[:, 1] <= RIGHT_RAD)
    median = f"{1e3 * np.median(errors[right, 0]):.1f}" if right.any() else "-"
    return f"{right.sum()} of {len(found)}", f"{(~right).sum()}", median


def _table(title: str, columns: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    print(f"**{title}**\n\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for line in lines:
        print(f"| {' | '.join(line)} |", flush=True)
    print()


if __name__ == "__main__":
    sys.exit(main())
