"""The robot that mock devices share."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np

from amr_drivers.playing import Shared
from amr_slam.geometry import Array, wrap_angle
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    laboratory,
    plan_tour,
    take_scan,
)

_KEPT = 250
"""Wheel samples and poses kept: 5 s at 50 Hz."""


class Stage:
    """A seeded laboratory and a robot on its tour in it, steered by the truth. Thread-safe."""

    def __init__(self, seed: int) -> None:
        self._world = laboratory(seed)
        tour = plan_tour(self._world)
        self._follower = PathFollower(tour.path_in_map_m)
        self._lock = threading.Lock()
        self.start_ns = time.monotonic_ns()
        self._robot = SimulatedRobot(
            world=self._world,
            world_from_map=tour.world_from_map,
            scanners=(),
            seed=seed,
            start_ns=self.start_ns,
        )
        self._wheels: deque[WheelSample] = deque(maxlen=_KEPT)
        self._poses: deque[tuple[int, Array]] = deque(maxlen=_KEPT)
        self._remember_pose()

    def wheels_after(self, stamp_ns: int) -> WheelSample:
        """The first kept wheel sample after ``stamp_ns``; the robot moves on until there is one."""
        with self._lock:
            while not self._wheels or self._wheels[-1].stamp_ns <= stamp_ns:
                self._advance()
            return next(sample for sample in self._wheels if sample.stamp_ns > stamp_ns)

    def scan(self, model: ScannerModel, stamp_ns: int, rng: np.random.Generator, seq: int) -> Scan:
        """What a scanner measures in the sweep that begins at ``stamp_ns``."""
        end_ns = stamp_ns + round(1e9 * model.sweep_s)
        with self._lock:
            while self._poses[-1][0] < end_ns:
                self._advance()
            kept = list(self._poses)
        known_s = np.array([(ns - stamp_ns) * 1e-9 for ns, _ in kept])
        poses = np.array([pose for _, pose in kept])
        beams_s = np.linspace(0.0, model.sweep_s, model.beams)
        world_from_base = np.column_stack(
            [np.interp(beams_s, known_s, column) for column in poses.T]
        )
        return take_scan(model, self._world, world_from_base, rng, stamp_ns=stamp_ns, seq=seq)

    def _advance(self) -> None:
        v_mps, omega_radps = self._follower.steer(self._robot.map_from_base)
        for sample in self._robot.advance(v_mps, omega_radps):
            if isinstance(sample, WheelSample):
                self._wheels.append(sample)
        self._remember_pose()

    def _remember_pose(self) -> None:
        pose = self._robot.world_from_base.as_array()
        if self._poses:  # unwrapped, to interpolate
            last_rad = float(self._poses[-1][1][2])
            pose[2] = last_rad + wrap_angle(float(pose[2]) - last_rad)
        self._poses.append((self._robot.stamp_ns, pose))


STAGES: Shared[int, Stage] = Shared(Stage)
"""By seed."""
