"""What cameras say changes no bit of what the robot says."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import pytest

from amr_slam.clouds import CloudParams
from amr_slam.engine import SlamEngine
from amr_slam.fusion import FilterParams
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.reporting import pose_message
from amr_slam.samples import Scan, WheelSample
from amr_slam.shadow import Shadow, ShadowSettings
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    laboratory,
    opposite_scanners,
    plan_tour,
)

MODELS = opposite_scanners(ScannerModel(sigma_range_m=0.01))
UTC_NS = 1_790_000_000 * 10**9


@functools.cache
def samples() -> tuple[Scan | WheelSample, ...]:
    world = laboratory(3)
    tour = plan_tour(world)
    robot = SimulatedRobot(
        world=world, world_from_map=tour.world_from_map, scanners=MODELS, scan_period_s=1.0, seed=3
    )
    follower = PathFollower(tour.path_in_map_m)
    taken: list[Scan | WheelSample] = []
    while robot.stamp_ns < 12 * 10**9:
        taken += robot.advance(*follower.steer(robot.map_from_base))
    return tuple(taken)


def published(shadow: Shadow | None) -> list[bytes]:
    """Every pose that goes out, as the loop makes it; the cameras contradict each of them."""
    names = {sample.scanner for sample in samples() if isinstance(sample, Scan)}
    placed = dict(zip(sorted(names), MODELS, strict=True))
    localizer = Localizer(
        LocalizerParams(),
        FilterParams(),
        CloudParams(),
        DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5),
        {n: Mounting(base_from_lidar=m.base_from_lidar) for n, m in placed.items()},
        "mapping",
    )
    params = SlamParams()
    engine = SlamEngine(params, PointMap(params.map, "lab"), "mapping")
    payloads: list[bytes] = []
    for sample in samples():
        localizer.handle(sample)
        request = localizer.take_request()
        if request is not None:
            localizer.handle(engine.update(request))
        estimate = localizer.estimate(sample.stamp_ns)
        if isinstance(sample, Scan) or estimate is None:
            continue
        message = pose_message(
            estimate, robot="amr7", seq=len(payloads), utc_from_monotonic_ns=UTC_NS, map_id=None
        )
        payloads.append(message.encode())
        if shadow is not None:
            shadow.said(message)
            wrong = {"x": message.x + 5.0, "y": -message.y, "theta": 0.0, "stamp": message.stamp}
            shadow.heard(json.dumps(wrong).encode())
            if len(payloads) % 100 == 0:
                shadow.turn(message.stamp)
    return payloads


class Idle(Shadow):
    def _run(self) -> None:
        pass


@pytest.mark.timeout(300)
def test_poses_are_the_same_to_the_bit_with_and_without_shadow_mode(tmp_path: Path) -> None:
    shadow = Idle(ShadowSettings(key="cameras/pose", directory=tmp_path, clock_s=0.0), "amr7")
    with_cameras = published(shadow)
    shadow.turn(2e9)
    shadow._file.close()
    assert shadow.part().count > 300
    assert shadow.part().mean_m > 4.0
    assert with_cameras == published(None)
