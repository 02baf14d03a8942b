"""The robot whose devices fail: simulated, in real time, at the far ends of its drivers' lines."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Self

import numpy as np

from amr_drivers.emulators import standing_in
from amr_drivers.emulators.odometry import EmulatedOdometry
from amr_drivers.emulators.scanner import StandIn
from amr_drivers.emulators.surroundings import Surroundings
from amr_slam.config import Config
from amr_slam.recording import Trajectory
from amr_slam.simulation import Vehicle
from amr_slam.studies.faults.place import Place

_VEHICLE = Vehicle(
    counts_per_turn=4096, left_radius_error=0.004, right_radius_error=0.003, track_error=0.005
)
"""Worn by less than a per cent, as a calibrated robot's wheels are after some months."""
_SEED = 7


class FailingRobot:
    """Drives its tour, whatever anybody says of where it is. A context manager."""

    def __init__(self, config: Config, place: Place, scan_period_s: float) -> None:
        """Raises ValueError for devices that cannot be emulated, OSError or DriverError where
        their lines cannot be had."""
        self.scanners: dict[str, StandIn] = {}
        with ExitStack() as opened:
            seen = {}
            for scanner in config.scanners:
                device = opened.enter_context(standing_in.scanner(scanner.driver, scanner.options))
                mounting = scanner.mounting.mounting
                self.scanners[scanner.name] = device
                seen[scanner.name] = device, mounting.base_from_lidar, mounting.upside_down
            self.wheels: EmulatedOdometry = opened.enter_context(
                standing_in.odometry(config.odometry.driver, config.odometry.options)
            )
            self.surroundings = Surroundings(
                seen,
                self.wheels,
                config.drive,
                seed=_SEED,
                scan_period_s=scan_period_s,
                place=(place.world, place.tour),
                vehicle=_VEHICLE,
            )
            self._devices = opened.pop_all()
        self._truth: list[tuple[int, float, float, float]] = []
        self._carry_m = 0.0
        self._stopping = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._drive, name="robot", daemon=True)
        self._thread.start()

    def carry(self, way_m: float) -> None:
        """With its next step the robot stands so much further along its tour."""
        self._carry_m = way_m

    def truth(self, since_ns: int) -> Trajectory:
        """Where it really was, ``world_from_base``, from ``time.monotonic_ns()`` on."""
        rows = [row for row in list(self._truth) if row[0] >= since_ns]
        return Trajectory(
            stamps_ns=np.array([row[0] for row in rows], dtype=np.int64),
            poses=np.array([row[1:] for row in rows], dtype=np.float64).reshape(-1, 3),
        )

    def check(self) -> None:
        """Raises RuntimeError when the robot itself has failed, which is nobody's fault."""
        if self._failure is not None:
            raise RuntimeError("the emulated robot has failed") from self._failure

    def close(self) -> None:
        """Its ports are gone then. Idempotent."""
        self._stopping.set()
        self._thread.join()
        self._devices.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _drive(self) -> None:
        surroundings = self.surroundings
        try:
            while not self._stopping.is_set():
                carry_m, self._carry_m = self._carry_m, 0.0
                if carry_m:
                    surroundings.carry(carry_m)
                stamp_ns = surroundings.step()
                pose = surroundings.robot.world_from_base
                self._truth.append((stamp_ns, pose.x_m, pose.y_m, pose.theta_rad))
        except BaseException as error:  # noqa: BLE001  # told by check(), in the main thread
            self._failure = error
