"""How long a fleet does not know: a router that is killed and comes back, a robot that hangs."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from amr_slam.client import FleetListener, RobotView
from amr_slam.studies.fleet.processes import program
from amr_slam.studies.fleet.robots import name_of

_AWAY_S: Final = 3.0
_PATIENCE_S: Final = 30.0
_NAME: Final = name_of(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outages:
    """In seconds; the longest of all tries."""

    back_s: float
    """From the router's return to the next pose."""
    gone_s: float
    """From the robot's freezing to the fall of its ``alive`` token."""
    longest_put_s: float
    """For which publishing kept the robot's loop meanwhile."""


def outages(endpoint: str, tries: int) -> Outages:
    """A robot, a listener and a router at ``endpoint``. Raises TimeoutError when a pose or the
    token's fall is missing for half a minute."""
    back_s, gone_s = [], []
    with program("robots", endpoint) as robot:
        for _ in range(tries):
            with program("router", endpoint) as router, FleetListener(endpoint, [_NAME]) as fleet:
                _wait(fleet, lambda view: view.poses > 0)
                router.process.kill()
                router.process.wait()
                time.sleep(_AWAY_S)
                with program("router", endpoint) as second:
                    back_s.append(_next_pose_s(fleet))
                    _wait(fleet, lambda view: view.alive)
                    robot.process.send_signal(signal.SIGSTOP)
                    gone_s.append(_wait(fleet, lambda view: not view.alive))
                    robot.process.send_signal(signal.SIGCONT)
                    _wait(fleet, lambda view: view.alive)
                    second.stop()
        told = robot.end()
    return Outages(back_s=max(back_s), gone_s=max(gone_s), longest_put_s=told["longest_put_s"])


def _next_pose_s(fleet: FleetListener) -> float:
    before = fleet.view(_NAME).poses
    return _wait(fleet, lambda view: view.poses > before)


def _wait(fleet: FleetListener, condition: Callable[[RobotView], bool]) -> float:
    """Seconds until it held."""
    begun_s = time.monotonic()
    if not fleet.wait_for(lambda views: condition(views[_NAME]), _PATIENCE_S):
        raise TimeoutError(f"{_NAME}: waited {_PATIENCE_S:g} s in vain")
    return time.monotonic() - begun_s
