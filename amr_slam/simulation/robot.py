"""A differential-drive robot in a world: commands in, samples of its devices and the truth out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation.grid import ClearanceGrid
from amr_slam.simulation.people import PERSON_RADIUS_M, People
from amr_slam.simulation.scanner import ScannerModel, take_scan
from amr_slam.simulation.world import World

WHEEL_PERIOD_NS = 20_000_000
"""Wheel counts come at 50 Hz."""

# The protective field of the safety scanners: whoever is nearer than this to the hull stops us.
_PROTECTIVE_FIELD_M = 0.2
# Sweeps up to this long can be told from the poses that are kept.
_HISTORY_S = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Vehicle:
    """The drive. Its controller, like the odometry, believes in the nominal measures."""

    radius_m: Annotated[float, Gt(0)] = 0.35
    """Of the round hull, about the middle of the axle."""
    wheel_radius_m: Annotated[float, Gt(0)] = 0.1
    """Nominal, both wheels."""
    track_m: Annotated[float, Gt(0)] = 0.5
    """Nominal distance between the wheels."""
    left_radius_error: float = 0.0
    """True radius of the left wheel = nominal x (1 + this)."""
    right_radius_error: float = 0.0
    """The same of the right wheel."""
    track_error: float = 0.0
    """True track = nominal x (1 + this): wheels touch the floor along a width."""
    slip_m: Annotated[float, Ge(0)] = 0.001
    """Deviation of each wheel's way on the floor after 1 m; grows with the root of the way."""
    counts_per_turn: Annotated[int, Gt(0)] = 65_536
    """Encoder counts of one turn of a wheel: sets the smallest angle in a wheel sample."""
    acceleration_mps2: Annotated[float, Gt(0)] = 0.5
    """Limit both ways: a loaded AMR."""
    turn_acceleration_radps2: Annotated[float, Gt(0)] = 2.0
    """Limit both ways."""


class SimulatedRobot:
    """The truth, stepped by commands. Same arguments and commands: same samples, bit for bit.

    The start pose is the origin of the map: ``map_from_base`` begins at the identity. Nothing
    ever drives through a wall or a person: the robot stops instead, and ``bumps`` counts each.
    """

    def __init__(
        self,
        *,
        world: World,
        world_from_map: Pose2,
        scanners: Sequence[ScannerModel],
        vehicle: Vehicle | None = None,
        people: int = 0,
        scan_period_s: float = 2.0,
        seed: int = 0,
        start_ns: int = 0,
    ) -> None:
        """``world_from_map``: the start pose. Every scanner starts a sweep every
        ``scan_period_s``. Raises ValueError when the start is not free or a sweep too long."""
        self._world = world
        self._vehicle = vehicle or Vehicle()
        if world.clearance(world_from_map.translation[None])[0] < self._vehicle.radius_m:
            raise ValueError(f"the robot does not fit at {world_from_map}")
        if any(m.sweep_s > min(_HISTORY_S - 0.02, scan_period_s) for m in scanners):
            raise ValueError(f"sweeps must be shorter than {_HISTORY_S - 0.02} s and the period")
        motion, noise, walks = np.random.default_rng(seed).spawn(3)
        self._slip_rng, self._noise_rng = motion, noise
        self._grid = ClearanceGrid.of(world)
        self._people = People(
            people,
            self._grid,
            world_from_map.translation,
            self._vehicle.radius_m,
            walks,
        )
        self.world_from_map = world_from_map
        self.bumps = 0
        self._pose = world_from_map
        self._stamp_ns = start_ns
        self._v_mps = self._omega_radps = 0.0
        self._wheels_rad = np.zeros(2)
        self._heading_rad = world_from_map.theta_rad  # never wrapped, to interpolate
        self._history: deque[tuple[float, Array, Array]] = deque()
        self._remember()
        self._start_ns = start_ns
        self._scan_period_ns = round(1e9 * scan_period_s)
        self._scanners = tuple(scanners)
        self._scans_taken = [0] * len(self._scanners)

    @property
    def stamp_ns(self) -> int:
        return self._stamp_ns

    @property
    def world_from_base(self) -> Pose2:
        """The truth at ``stamp_ns``."""
        return self._pose

    @property
    def map_from_base(self) -> Pose2:
        """The truth at ``stamp_ns`` as SLAM should tell it."""
        return self.world_from_map.inverse() @ self._pose

    @property
    def people_m(self) -> Array:
        """(k, 2) in the world."""
        return self._people.positions_m

    def advance(self, v_mps: float, omega_radps: float) -> list[WheelSample | Scan]:
        """Drive for one wheel period by a command (forward and turning speed).

        Returns the scans whose sweeps ended in it, then the wheel sample at its end; the first
        call also the wheel sample at the start, before all.
        """
        before = [self._wheel_sample()] if self._stamp_ns == self._start_ns else []
        dt_s = 1e-9 * WHEEL_PERIOD_NS
        self._people.walk(dt_s, self._pose.translation)
        self._drive(v_mps, omega_radps, dt_s)
        self._stamp_ns += WHEEL_PERIOD_NS
        self._remember()
        return [*before, *self._finished_scans(), self._wheel_sample()]

    def carry(self, world_from_base: Pose2) -> None:
        """Somebody lifts the robot, which notices nothing, and sets it down there, standing.

        Raises ValueError where it does not fit.
        """
        if self._world.clearance(world_from_base.translation[None])[0] < self._vehicle.radius_m:
            raise ValueError(f"the robot does not fit at {world_from_base}")
        self._pose, self._heading_rad = world_from_base, world_from_base.theta_rad
        self._v_mps = self._omega_radps = 0.0
        base = np.array([world_from_base.x_m, world_from_base.y_m, self._heading_rad])
        # A sweep under way sees the new place alone.
        self._history = deque((stamp, base, people) for stamp, _, people in self._history)

    def _drive(self, v_mps: float, omega_radps: float, dt_s: float) -> None:
        vehicle = self._vehicle
        if self._person_ahead(v_mps):
            v_mps = 0.0
        self._v_mps = _approach(self._v_mps, v_mps, vehicle.acceleration_mps2 * dt_s)
        self._omega_radps = _approach(
            self._omega_radps, omega_radps, vehicle.turn_acceleration_radps2 * dt_s
        )
        half_turn = 0.5 * self._omega_radps * vehicle.track_m
        turned = np.array([self._v_mps - half_turn, self._v_mps + half_turn]) * (
            dt_s / vehicle.wheel_radius_m
        )
        errors = 1.0 + np.array([vehicle.left_radius_error, vehicle.right_radius_error])
        way = turned * vehicle.wheel_radius_m * errors
        way = way + vehicle.slip_m * np.sqrt(np.abs(way)) * self._slip_rng.normal(size=2)
        turn_rad = (way[1] - way[0]) / (vehicle.track_m * (1.0 + vehicle.track_error))
        pose = self._pose @ Pose2.exp([0.5 * (way[0] + way[1]), 0.0, turn_rad])
        if not self._fits(pose):
            self.bumps += self._v_mps != 0.0
            self._v_mps = self._omega_radps = 0.0
            return
        self._pose = pose
        self._heading_rad += turn_rad
        self._wheels_rad = self._wheels_rad + turned

    def _person_ahead(self, v_mps: float) -> bool:
        to_people = self._people.positions_m - self._pose.translation
        heading = np.sign(v_mps) * self._pose.rotation[:, 0]
        near = np.hypot(*to_people.T) < (
            self._vehicle.radius_m + PERSON_RADIUS_M + _PROTECTIVE_FIELD_M
        )
        return bool(np.any(near & (to_people @ heading > 0.0)))

    def _fits(self, pose: Pose2) -> bool:
        """Free of walls and people, or at least not moving towards them."""
        here, there = self._pose.translation, pose.translation
        if self._grid.at(there[None])[0] < self._vehicle.radius_m + self._grid.cell_m:
            clear = self._world.clearance(np.array([here, there]))
            if clear[1] < self._vehicle.radius_m and clear[1] < clear[0]:
                return False
        distance = np.hypot(*(self._people.positions_m - there).T)
        return not np.any(distance < self._vehicle.radius_m + PERSON_RADIUS_M)

    def _remember(self) -> None:
        base = np.array([self._pose.x_m, self._pose.y_m, self._heading_rad])
        self._history.append((1e-9 * self._stamp_ns, base, self._people.positions_m))
        if self._history[-1][0] - self._history[0][0] > _HISTORY_S:
            self._history.popleft()

    def _finished_scans(self) -> list[Scan]:
        scans: list[Scan] = []
        for i, model in enumerate(self._scanners):
            due_ns = self._scans_taken[i] * self._scan_period_ns + round(1e9 * model.phase_s)
            stamp_ns = self._start_ns + due_ns
            while stamp_ns + round(1e9 * model.sweep_s) <= self._stamp_ns:
                scans.append(self._scan(model, stamp_ns, self._scans_taken[i]))
                self._scans_taken[i] += 1
                stamp_ns += self._scan_period_ns
        return sorted(scans, key=lambda scan: scan.stamp_ns)

    def _scan(self, model: ScannerModel, stamp_ns: int, seq: int) -> Scan:
        times = 1e-9 * stamp_ns + np.linspace(0.0, model.sweep_s, model.beams)
        known = np.array([entry[0] for entry in self._history])
        base = np.array([entry[1] for entry in self._history])
        people = np.array([entry[2] for entry in self._history])
        row = np.clip(np.searchsorted(known, times) - 1, 0, len(known) - 2)
        part = ((times - known[row]) / (known[row + 1] - known[row]))[:, None]
        return take_scan(
            model,
            self._world,
            base[row] + part * (base[row + 1] - base[row]),
            self._noise_rng,
            stamp_ns=stamp_ns,
            seq=seq,
            people_m=people[row] + part[:, :, None] * (people[row + 1] - people[row]),
            person_radius_m=PERSON_RADIUS_M,
        )

    def _wheel_sample(self) -> WheelSample:
        count_rad = 2.0 * math.pi / self._vehicle.counts_per_turn
        left, right = np.floor(self._wheels_rad / count_rad) * count_rad
        return WheelSample(stamp_ns=self._stamp_ns, left_rad=float(left), right_rad=float(right))


def _approach(value: float, wanted: float, step: float) -> float:
    return min(max(wanted, value - step), value + step)
