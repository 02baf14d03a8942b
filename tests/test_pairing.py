"""The merged cloud of two scanners on a moving robot, against the truth of the simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from labs import EXACT

from amr_slam.clouds import CloudParams
from amr_slam.fusion import FilterParams, PoseFilter
from amr_slam.geometry import Pose2
from amr_slam.mounting import Mounting
from amr_slam.odometry import DifferentialDrive
from amr_slam.pairing import Pairing, end_ns
from amr_slam.samples import Outcome, Scan, WheelSample
from amr_slam.simulation import (
    SimulatedRobot,
    Vehicle,
    World,
    laboratory,
    opposite_scanners,
    plan_tour,
)

S = 1_000_000_000
DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
HERE = Mounting(base_from_lidar=Pose2.identity())


def hanging(scan: Scan) -> Scan:
    """The simulated scanner sweeps clockwise seen from above; hanging, it counts as ever."""
    return replace(scan, angle_min_rad=-scan.angle_min_rad, angle_step_rad=-scan.angle_step_rad)


def drive_and_merge(
    v_mps: float, omega_radps: float, phase_s: float, sweep_s: float
) -> tuple[float, int]:
    """(worst distance in m of a merged point to the true walls, points): the rear scanner hangs,
    and starts its sweep ``phase_s`` after the front one."""
    world: World = laboratory(4)
    front, rear = opposite_scanners(replace(EXACT, sweep_s=sweep_s))
    rear = replace(
        rear,
        phase_s=phase_s,
        angle_min_rad=-rear.angle_min_rad,
        angle_step_rad=-rear.angle_step_rad,
    )
    robot = SimulatedRobot(
        world=world,
        world_from_map=plan_tour(world).world_from_map,
        scanners=(front, rear),
        vehicle=Vehicle(slip_m=0.0),
        scan_period_s=1.0,
    )
    mountings = {
        "front": Mounting(base_from_lidar=front.base_from_lidar),
        "rear": Mounting(base_from_lidar=rear.base_from_lidar, upside_down=True),
    }
    pairing = Pairing(mountings, CloudParams(), wait_s=0.9)
    wheels: PoseFilter | None = None
    before: WheelSample | None = None
    truth = {robot.stamp_ns: robot.world_from_base}
    worst, points = 0.0, 0
    for _ in range(300):
        for sample in robot.advance(v_mps, omega_radps):
            if isinstance(sample, Scan):
                scan = hanging(sample) if sample.scanner == "rear" else sample
                assert pairing.check(scan) is Outcome.ACCEPTED
                pairing.keep(scan)
                continue
            if wheels is None or before is None:
                wheels = PoseFilter(
                    FilterParams(), sample.stamp_ns, Pose2.identity(), 1e-6 * np.eye(3)
                )
            else:
                wheels.predict(DRIVE.motion(before, sample))
            before = sample
        truth[robot.stamp_ns] = robot.world_from_base
        assert wheels is not None
        scans = pairing.take(wheels.stamp_ns)
        if len(scans) < 2:
            continue
        merged, late = pairing.merged(scans, wheels)
        assert merged is not None
        assert late == 0
        assert {view.scanner for view in merged.views} == {"front", "rear"}
        pose = _between(truth, merged.cloud.stamp_ns)
        off = np.abs(world.clearance(pose @ merged.cloud.points_m))
        worst, points = max(worst, float(np.quantile(off, 0.99))), points + len(off)
    return worst, points


def _between(truth: dict[int, Pose2], stamp_ns: int) -> Pose2:
    step_ns = 20_000_000
    early = stamp_ns // step_ns * step_ns
    if early == stamp_ns:
        return truth[early]
    delta = (truth[early].inverse() @ truth[early + step_ns]).log()
    return truth[early] @ Pose2.exp((stamp_ns - early) / step_ns * delta)


@pytest.mark.parametrize("phase_s", [0.0, 0.013, 0.43])
@pytest.mark.parametrize("sweep_s", [0.03, 0.15])
def test_two_scanners_out_of_phase_on_a_turning_robot_draw_the_walls(
    phase_s: float, sweep_s: float
) -> None:
    worst_m, points = drive_and_merge(0.25, 0.5, phase_s, sweep_s)
    assert points > 1500
    assert worst_m < 0.005


def scan_at(scanner: str, stamp_ns: int) -> Scan:
    return Scan(
        scanner=scanner,
        stamp_ns=stamp_ns,
        ranges_m=np.full(90, 3.0),
        angle_min_rad=0.0,
        angle_step_rad=0.01,
    )


def standing(until_ns: int) -> PoseFilter:
    wheels = PoseFilter(FilterParams(), 0, Pose2.identity(), np.eye(3))
    for stamp_ns in range(20_000_000, until_ns + 1, 20_000_000):
        sample = WheelSample(stamp_ns=stamp_ns, left_rad=0.0, right_rad=0.0)
        wheels.predict(DRIVE.motion(replace(sample, stamp_ns=stamp_ns - 20_000_000), sample))
    return wheels


def test_a_scan_is_not_merged_with_one_that_is_older_than_its_period() -> None:
    """The rear scanner died while the registration was busy: its last scan waits in vain."""
    pairing = Pairing({"front": HERE, "rear": HERE}, CloudParams(), wait_s=0.15)
    for name, stamp_ns in (("front", 0), ("rear", 0), ("front", S), ("rear", S), ("front", 3 * S)):
        pairing.check(scan_at(name, stamp_ns + 1))
        pairing.keep(scan_at(name, stamp_ns + 1))
    wheels = standing(4 * S)
    scans = pairing.take(4 * S)
    merged, late = pairing.merged(scans, wheels)
    assert merged is not None
    assert [view.scanner for view in merged.views] == ["front"]
    assert late == 1
    assert len(merged.cloud) == 90


def test_scans_less_than_a_period_apart_are_merged() -> None:
    pairing = Pairing({"front": HERE, "rear": HERE}, CloudParams(), wait_s=0.15)
    for name, stamp_ns in (("front", 0), ("rear", 0), ("rear", S), ("front", 2 * S - 1)):
        pairing.check(scan_at(name, stamp_ns + 1))
        pairing.keep(scan_at(name, stamp_ns + 1))
    merged, late = pairing.merged(pairing.take(3 * S), standing(3 * S))
    assert merged is not None
    assert (len(merged.views), late) == (2, 0)


def test_a_missing_scanner_is_named_after_two_and_a_half_periods_and_comes_back() -> None:
    pairing = Pairing({"front": HERE, "rear": HERE}, CloudParams(), wait_s=0.15)
    assert pairing.missing(4 * S, 0) == []
    assert pairing.missing(6 * S, 0) == ["front", "rear"]
    for number in range(5):
        pairing.check(scan_at("front", 2 * S * number))
        if number < 2:
            pairing.check(scan_at("rear", 2 * S * number))
    assert pairing.missing(2 * S + 4 * S, 0) == []
    assert pairing.missing(2 * S + 5 * S + 1, 0) == ["rear"]
    pairing.check(scan_at("rear", 9 * S))
    assert pairing.missing(9 * S + 1, 0) == []
    assert math.isclose(end_ns(scan_at("rear", 5)), 5)
