"""A simulated robot on its tour of a simulated world, told to emulated devices as it goes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from amr_drivers.emulators.odometry import EmulatedOdometry
from amr_drivers.emulators.scanner import StandIn
from amr_slam.geometry import Pose2
from amr_slam.odometry import Odometry, TricycleDrive
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation import (
    WHEEL_PERIOD_NS,
    PathFollower,
    SimulatedRobot,
    Tour,
    Vehicle,
    World,
    laboratory,
    plan_tour,
)

_STEP_S = 1e-9 * WHEEL_PERIOD_NS


class Surroundings:
    """What the scanners see and the wheels count; one thread calls :meth:`step`."""

    def __init__(
        self,
        scanners: Mapping[str, tuple[StandIn, Pose2, bool]],
        wheels: EmulatedOdometry,
        drive: Odometry,
        *,
        seed: int,
        scan_period_s: float,
        place: tuple[World, Tour] | None = None,
        vehicle: Vehicle | None = None,
    ) -> None:
        """``scanners``: by name the device, ``base_from_lidar``, and whether it hangs head down.
        ``drive``: a tricycle's counts are made from its measures, all others are two wheels'.
        ``place``: where to drive; the laboratory of ``seed`` when there is none."""
        self._scanners = dict(scanners)
        self._wheels = wheels
        self._drive = drive
        world = laboratory(seed) if place is None else place[0]
        tour = plan_tour(world) if place is None else place[1]
        self._follower = PathFollower(tour.path_in_map_m)
        self.robot = SimulatedRobot(
            world=world,
            world_from_map=tour.world_from_map,
            scanners=[
                replace(device.optics, name=name, base_from_lidar=pose, sigma_range_m=0.01)
                for name, (device, pose, _) in self._scanners.items()
            ],
            vehicle=vehicle or Vehicle(counts_per_turn=4096),
            scan_period_s=scan_period_s,
            seed=seed,
            start_ns=time.monotonic_ns(),
        )
        """The truth."""
        self.disturb_scan: Callable[[Scan], Scan | None] = lambda scan: scan
        """What becomes of a scan before its device measures it; None: it measures nothing."""
        self.disturb_wheels: Callable[[WheelSample], WheelSample | None] = lambda wheels: wheels
        """What becomes of the wheels before they are counted."""
        self._late_ns = 0
        self._rolled_rad = 0.0

    @property
    def map_from_base(self) -> Pose2:
        """Where the robot really is; the map begins where it stood first."""
        return self.robot.map_from_base

    def step(self) -> int:
        """20 ms: each scan is measured as its sweep ends, the wheels at the end.

        Returns ``time.monotonic_ns()`` of the end, at which :attr:`robot` is where it is now.
        """
        v_mps, omega_radps = self._follower.steer(self.robot.map_from_base)
        for sample in self.robot.advance(v_mps, omega_radps):
            due_ns = sample.stamp_ns + self._late_ns
            if isinstance(sample, Scan):
                self._measure(sample, due_ns)
            else:
                # A world that is late stands still meanwhile.
                self._late_ns += _sleep_until(due_ns)
                wheels = self.disturb_wheels(sample)
                if wheels is not None:
                    self._turn(wheels, v_mps, omega_radps)
        return self.robot.stamp_ns + self._late_ns

    @property
    def paused_s(self) -> float:
        """For how long the world stood still because the processor was late."""
        return 1e-9 * self._late_ns

    def carry(self, way_m: float) -> None:
        """Lift the robot and set it down so much further along its tour."""
        self.robot.carry(self.robot.world_from_map @ self._follower.skip(way_m))

    def _measure(self, scan: Scan, due_ns: int) -> None:
        disturbed = self.disturb_scan(scan)
        if disturbed is None:
            return
        _sleep_until(due_ns + round(1e9 * scan.sweep_s))
        device, _, hangs = self._scanners[scan.scanner]
        device.measure(disturbed.ranges_m[::-1] if hangs else disturbed.ranges_m)

    def _turn(self, sample: WheelSample, v_mps: float, omega_radps: float) -> None:
        if not isinstance(self._drive, TricycleDrive):
            self._wheels.turn(sample.left_rad, sample.right_rad, dt_s=_STEP_S)
            return
        sideways_mps = omega_radps * self._drive.wheel_base_m
        way_m = math.hypot(v_mps, sideways_mps) * _STEP_S
        self._rolled_rad += way_m / self._drive.radius_m
        steer_rad = math.atan2(sideways_mps, v_mps) if way_m else 0.0
        self._wheels.turn(self._rolled_rad, steer_rad, dt_s=_STEP_S)


def _sleep_until(due_ns: int) -> int:
    """How much too late it is, in ns."""
    left_ns = due_ns - time.monotonic_ns()
    time.sleep(max(0.0, 1e-9 * left_ns))
    return max(0, -left_ns)
