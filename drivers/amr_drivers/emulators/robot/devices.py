"""The simulated robot and the devices on it, stepped in real time."""

from __future__ import annotations

import queue
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self

from annotated_types import Ge, Gt, Interval

from amr_drivers.can_odometry.settings import Settings
from amr_drivers.emulators.s300 import EmulatedS300, S300Model
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_drivers.emulators.wheels import EmulatedWheels
from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation import (
    WHEEL_PERIOD_NS,
    ScannerModel,
    SimulatedRobot,
    Tour,
    Vehicle,
    laboratory,
    opposite_scanners,
    plan_tour,
)

SEQUENCE_SIGNAL = "Sequence"
"""The frame counter in config/wheels.dbc."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotModel:
    """Which robot, in which laboratory, and how far its devices are from perfect."""

    seed: Annotated[int, Ge(0)] = 7
    """Of the laboratory and of all noise."""
    people: Annotated[int, Ge(0)] = 3
    """People who walk about: what a laboratory has in working hours."""
    scan_period_s: Annotated[float, Gt(0.04)] = 0.2
    """Of each scanner. A real S300 sends every 0.04 s; two small processor cores have to carry
    robot and daemon together, and the daemon takes one scan in 2 s anyway."""
    sigma_range_m: Annotated[float, Interval(ge=0, le=1)] = 0.01
    """Standard deviation of a range, beside the S300's step of 1 cm."""
    left_radius_error: float = 0.010
    """Share by which the left wheel is larger than the daemon is told: worn or wrongly measured."""
    right_radius_error: float = 0.007
    """The same of the right one: tyres of a pair differ by less than both from the data sheet."""
    track_error: float = 0.01
    """Share by which the contact points are further apart: wheels have a width."""

    def tour(self) -> Tour:
        """The way round this laboratory; its start is where the robot stands first."""
        return plan_tour(laboratory(self.seed))

    def simulated(self, start_ns: int) -> SimulatedRobot:
        """The robot at the start of its tour."""
        return SimulatedRobot(
            world=laboratory(self.seed),
            world_from_map=self.tour().world_from_map,
            scanners=opposite_scanners(ScannerModel(sigma_range_m=self.sigma_range_m)),
            vehicle=Vehicle(
                left_radius_error=self.left_radius_error,
                right_radius_error=self.right_radius_error,
                track_error=self.track_error,
                counts_per_turn=4096,
            ),
            people=self.people,
            scan_period_s=self.scan_period_s,
            seed=self.seed,
            start_ns=start_ns,
        )


class EmulatedRobot:
    """Two S300s on pseudo-terminals and wheel counts on an slcan adapter, in real time.

    The ports are ``scanner-front``, ``scanner-rear`` and ``can`` in ``directory``, as /dev/serial/
    by-id names them on a robot. The robot moves when :meth:`step` is called, from one thread. A
    context manager: leaving it removes the ports.
    """

    def __init__(self, directory: Path, dbc: str, model: RobotModel | None = None) -> None:
        """Raises ValueError for a DBC file without the wheels' signals, OSError when the ports
        cannot be made."""
        self._robot = (model or RobotModel()).simulated(time.monotonic_ns())
        self._wheels = EmulatedWheels(Settings(dbc=dbc, sequence_signal=SEQUENCE_SIGNAL))
        self._paused_ns = 0
        directory.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            self._can = stack.enter_context(EmulatedSlcan(directory / "can"))
            self._senders: dict[str, _ScanSender] = {}
            for name in ("front", "rear"):
                self._senders[name] = _ScanSender(directory / f"scanner-{name}")
                stack.callback(self._senders[name].close)
            self._stack = stack.pop_all()

    def step(self, v_mps: float, omega_radps: float) -> tuple[int, Pose2]:
        """Drive for one wheel period (20 ms) and return at its end, when its counts are sent.

        Returns the truth: ``time.monotonic_ns()`` of the counts and ``map_from_base``, where the
        map's origin is the robot's first pose.
        """
        # The step is computed when it begins, so that each scan can leave just as its sweep ends.
        samples = self._robot.advance(v_mps, omega_radps)
        for sample in samples:
            if isinstance(sample, Scan):
                end_ns = sample.stamp_ns + round(1e9 * sample.sweep_s) + self._paused_ns
                self._senders[sample.scanner].put(end_ns, sample.ranges_m)
        stamp_ns = self._wait_for_end()
        wheels = samples[-1]
        if isinstance(wheels, WheelSample):
            for frame in self._wheels.frames(wheels.left_rad, wheels.right_rad):
                self._can.send(frame)
        return stamp_ns, self._robot.map_from_base

    def _wait_for_end(self) -> int:
        """Until the simulated time has come; where it has passed, the world stood still."""
        due_ns = self._robot.stamp_ns + self._paused_ns
        late_ns = -_sleep_until(due_ns)
        if late_ns <= WHEEL_PERIOD_NS:
            return due_ns
        # Sending old counts in a burst would be a lie about when the robot was where.
        self._paused_ns += late_ns
        return due_ns + late_ns

    def close(self) -> None:
        """Remove the ports. Idempotent."""
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


class _ScanSender:
    """One scanner's electronics: sends each scan when its sweep has ended, at the baud rate."""

    def __init__(self, link: Path) -> None:
        self._device = EmulatedS300(link, S300Model(paced=True))
        self._scans: queue.SimpleQueue[tuple[int, Array] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._send, name=link.name, daemon=True)
        self._thread.start()

    def put(self, due_ns: int, ranges_m: Array) -> None:
        self._scans.put((due_ns, ranges_m))

    def close(self) -> None:
        self._scans.put(None)
        self._thread.join()
        self._device.close()

    def _send(self) -> None:
        while (item := self._scans.get()) is not None:
            due_ns, ranges_m = item
            _sleep_until(due_ns)
            self._device.measure(ranges_m)


def _sleep_until(due_ns: int) -> int:
    """Sleep if there is time left; how much there was in ns, negative when it is too late."""
    left_ns = due_ns - time.monotonic_ns()
    if left_ns > 0:
        time.sleep(1e-9 * left_ns)
    return left_ns
