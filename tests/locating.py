"""Drives through small worlds that repeat themselves, located by the real engine."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from labs import EXACT, cloud_at, world_of

from amr_slam.clouds import CloudParams
from amr_slam.engine import SlamEngine
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import MapParams, PointMap
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.samples import PoseEstimate, Scan
from amr_slam.simulation import SimulatedRobot, World, opposite_scanners

DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
PARAMS = SlamParams()
HALF_TURN = Pose2(0.0, 0.0, math.pi)
BULGE = np.array([[1.5, 0.8, 1.5, 0.35], [1.5, 0.35, 2.3, 0.35], [2.3, 0.35, 2.3, 0.8]])
CABINET = np.array([[-9.0, -0.6, -8.2, -0.6], [-8.2, -0.6, -8.2, 0.2], [-8.2, 0.2, -9.0, 0.2]])
ROUND_THE_ROOM = ((-5.2, 2.6), (-5.2, -1.6), (-7.0, -1.7))
THROUGH_THE_DOOR = (*ROUND_THE_ROOM, (-5.0, 0.0), (-1.0, -0.2), (3.5, -0.2), (6.0, 0.0))


def twin_rooms(*, told_apart: bool = True) -> World:
    """A room and, half a turn about the origin away, the same room; a corridor joins them. A bulge
    in the corridor's wall, seen from there only, tells the two ends apart."""
    room = np.array(
        [
            [-4.0, 0.8, -4.0, 3.5], [-4.0, 3.5, -10.0, 3.5], [-10.0, 3.5, -10.0, -2.5],
            [-10.0, -2.5, -4.0, -2.5], [-4.0, -2.5, -4.0, -0.8],
            [-9.0, 0.2, -9.0, -0.6], *CABINET,
        ]
    )  # fmt: skip
    walls = np.array([[-4.0, 0.8, 4.0, 0.8], [-4.0, -0.8, 4.0, -0.8]])
    more = [BULGE] if told_apart else []
    return world_of(np.concatenate([room, -room, walls, *more]))


def map_of(world: World, poses: Sequence[tuple[float, float]]) -> PointMap:
    """At the truth, looking four ways from each place."""
    grown, rng = PointMap(MapParams()), np.random.default_rng(5)
    for number, (x, y) in enumerate(poses):
        pose = Pose2(x, y, 0.5 * math.pi * (number % 4))
        cloud = cloud_at(world, pose, rng, sigma_m=0.01, stamp_ns=number * 2_000_000_000)
        grown.insert(cloud, pose)
    return grown


def twin_map(world: World) -> PointMap:
    ends = [(x, y) for x in (-9.0, -7.0, -5.0) for y in (-1.6, 1.2, 2.7)]
    hall = [(x, 0.0) for x in (-5.0, -3.0, -1.0, 0.5)]
    half = [*ends, *hall]
    return map_of(world, [*half, *((-x, -y) for x, y in half), (1.0, -0.3), (2.5, -0.3)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """What the robot said right after a scan was registered, and where it was."""

    truth: Pose2
    said: PoseEstimate

    @property
    def off_m(self) -> float:
        return self.said.map_from_base.distance_to(self.truth)


class Driven:
    """A simulated robot with two scanners, its localizer and engine, in a map at the truth."""

    def __init__(
        self,
        world: World,
        known: PointMap,
        begin: Pose2,
        *,
        start: Pose2 | None = None,
        seed: int = 0,
        params: LocalizerParams | None = None,
    ) -> None:
        scanners = opposite_scanners(replace(EXACT, sigma_range_m=0.01))
        self.world, self.seed, self.scanners = world, seed, scanners
        self.robot = SimulatedRobot(world=world, world_from_map=begin, scanners=scanners, seed=seed)
        self.engine = SlamEngine(PARAMS, known, "localization")
        mountings = {s.name: Mounting(base_from_lidar=s.base_from_lidar) for s in scanners}
        self.localizer = Localizer(
            params or LocalizerParams(),
            FilterParams(),
            CloudParams(),
            DRIVE,
            mountings,
            "localization",
            None if start is None else (start, np.diag([1e-3, 1e-3, 1e-4])),
        )

    def carry_to(self, place: Pose2, world: World | None = None) -> None:
        """Lift the robot: its wheels and clocks notice nothing."""
        carried = SimulatedRobot(
            world=world or self.world,
            world_from_map=place,
            scanners=self.scanners,
            seed=self.seed,
            start_ns=self.robot.stamp_ns,
        )
        carried._wheels_rad = self.robot._wheels_rad
        self.robot = carried

    def along(self, way_m: Sequence[tuple[float, float]], v_mps: float = 0.3) -> Iterator[Moment]:
        """Drive from point to point; a moment for each registered scan."""
        for target in way_m:
            while (off := self._off(np.array(target)))[0] > 0.1:
                turn = 1.5 * off[1]
                ahead = v_mps if abs(off[1]) < 0.4 else 0.0
                yield from self.advance(ahead, max(-0.8, min(turn, 0.8)))

    def stand(self, seconds: float) -> Iterator[Moment]:
        for _ in range(round(seconds / 0.02)):
            yield from self.advance(0.0, 0.0)

    def advance(self, v_mps: float, omega_radps: float) -> Iterator[Moment]:
        for sample in self.robot.advance(v_mps, omega_radps):
            self.localizer.handle(sample)
            request = self.localizer.take_request()
            if request is None:
                continue
            self.localizer.handle(self.engine.update(request))
            said = self.localizer.estimate(self.robot.stamp_ns)
            assert said is not None
            yield Moment(truth=self.robot.world_from_base, said=said)

    def _off(self, target_m: Array) -> tuple[float, float]:
        """Distance and bearing of a point in the world."""
        pose = self.robot.world_from_base
        ahead = target_m - pose.translation
        bearing = math.atan2(ahead[1], ahead[0]) - pose.theta_rad
        return float(np.hypot(*ahead)), wrap_angle(bearing)

    def stand_blind(self, seconds: float, reading_m: float) -> list[PoseEstimate]:
        """Scanners that report one and the same nonsense for each beam."""
        said: list[PoseEstimate] = []
        for _ in range(round(seconds / 0.02)):
            for sample in self.robot.advance(0.0, 0.0):
                blind = sample
                if isinstance(sample, Scan):
                    blind = replace(sample, ranges_m=np.full(len(sample.ranges_m), reading_m))
                self.localizer.handle(blind)
                request = self.localizer.take_request()
                if request is not None:
                    self.localizer.handle(self.engine.update(request))
                    estimate = self.localizer.estimate(self.robot.stamp_ns)
                    assert estimate is not None
                    said.append(estimate)
        return said
