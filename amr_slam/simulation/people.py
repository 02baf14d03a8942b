"""People who walk about: round, at random, and never into the robot or the furniture."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.geometry import Array
from amr_slam.simulation.grid import ClearanceGrid

PERSON_RADIUS_M = 0.2
"""Two legs at the height of a scanner, taken as one."""

_SPEED_MPS = 0.8
# People keep to places where a robot can pass by, so that neither waits for the other for ever.
_ROOM_M = 0.9
# A person leaves this much between herself and the robot.
_DISTANCE_M = 0.35


class People:
    """A number of people in one world; the same seed and calls give the same walks."""

    def __init__(
        self,
        count: int,
        grid: ClearanceGrid,
        robot_m: Array,
        robot_radius_m: float,
        rng: np.random.Generator,
    ) -> None:
        self._grid = grid
        self._rng = rng
        self._keep_m = robot_radius_m + PERSON_RADIUS_M + _DISTANCE_M
        cells = np.flatnonzero(grid.clearance_m > _ROOM_M)
        self._places = np.array([grid.centre(int(cell)) for cell in cells]).reshape(-1, 2)
        far = np.hypot(*(self._places - robot_m).T) > self._keep_m + 1.0
        if count > 0 and not far.any():
            raise ValueError(f"no room for {count} people")
        chosen = rng.choice(np.flatnonzero(far), count) if count else np.empty(0, dtype=np.int64)
        self._positions: Array = self._places[chosen]
        self._targets = self._positions.copy()

    @property
    def positions_m(self) -> Array:
        """(k, 2) a copy of where everybody is."""
        return self._positions.copy()

    def walk(self, dt_s: float, robot_m: Array) -> None:
        """Everybody goes on for ``dt_s`` towards a place of his own, or chooses another one."""
        for i, position in enumerate(self._positions):
            to_target = self._targets[i] - position
            distance = math.hypot(*to_target)
            if distance < _SPEED_MPS * dt_s:
                self._targets[i] = self._places[self._rng.integers(len(self._places))]
                continue
            step = position + to_target * (_SPEED_MPS * dt_s / distance)
            if self._may_stand(step, position, robot_m):
                self._positions[i] = step
            else:
                self._targets[i] = self._places[self._rng.integers(len(self._places))]

    def _may_stand(self, there: Array, here: Array, robot_m: Array) -> bool:
        if self._grid.at(there[None])[0] < PERSON_RADIUS_M + 0.1:
            return False
        to_robot = math.hypot(*(there - robot_m))
        return to_robot > self._keep_m or to_robot > math.hypot(*(here - robot_m))
