"""A way through a world that shows all of it, and the steering along it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2, readonly, wrap_angle
from amr_slam.simulation.casting import cast
from amr_slam.simulation.grid import ClearanceGrid
from amr_slam.simulation.planning import STEP_M, ShortPlanner
from amr_slam.simulation.rounds import long_round
from amr_slam.simulation.shapes import polygon_area
from amr_slam.simulation.world import World

_CRUISE_MPS = 0.3
_TURN_RADPS = 0.8
# With its turns about 85 scans at 0.5 Hz and 0.3 m/s, as in the paper's section 3.1.
_LENGTH_M = 43.0
# A room up to this size may be shown by a round of this length: the paper's has 200 m2.
_SHORT_AREA_M2 = 250.0
# The round must show this share of the floor from this near: laboratories reach 0.998.
_SHOWN_SHARE = 0.98
_SHOWN_M = 12.0
# Beside the hull on the planned way: what steering and a SLAM pose may be off.
_MARGIN_M = 0.15
# The same where doors leave no more: 0.95 m wide, for a hull of 0.7 m.
_DOOR_MARGIN_M = 0.07
# A short round must keep the wider margin on this share of what the narrower one reaches:
# laboratories have 0.9.
_REACHED_SHARE = 0.8
_LOOKAHEAD_M = 0.4
# Beyond this angle to its aim the robot turns on the spot.
_TURN_ON_SPOT_RAD = 0.8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tour:
    """A closed way, driven from ``world_from_map`` round to it again."""

    world_from_map: Pose2
    """The start pose: origin of the map that SLAM makes."""
    path_m: Array
    """(n, 2) read-only, world, 5 cm apart; the last point is next to the first."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "path_m", readonly(self.path_m))

    @property
    def path_in_map_m(self) -> Array:
        """(n, 2) the same way in the map frame."""
        return self.world_from_map.inverse() @ np.array(self.path_m)


def plan_tour(world: World, radius_m: float = 0.35) -> Tour:
    """A round through the free space for a robot of ``radius_m``.

    About 45 m long where that shows the whole room, as in the laboratories. In larger worlds, and
    in those of many rooms, as long as it takes to come near every place that can be reached.
    Raises ValueError when there is no room for one.
    """
    grid = ClearanceGrid.of(world)
    path = None
    if polygon_area(world.outline_m) <= _SHORT_AREA_M2:
        path = _short_round(world, grid, radius_m)
    if path is None:
        path = long_round(grid, radius_m + _DOOR_MARGIN_M)
    ahead = path[round(_LOOKAHEAD_M / STEP_M)] - path[0]
    start = Pose2(float(path[0, 0]), float(path[0, 1]), math.atan2(ahead[1], ahead[0]))
    return Tour(world_from_map=start, path_m=path)


def _short_round(world: World, grid: ClearanceGrid, radius_m: float) -> Array | None:
    """None where there is no room for it or it leaves too much out."""
    try:
        planner = ShortPlanner(grid, radius_m + _MARGIN_M)
        path = planner.closed_path(_LENGTH_M)
    except ValueError:
        return None
    if planner.area_m2 < _REACHED_SHARE * ShortPlanner(grid, radius_m + _DOOR_MARGIN_M).area_m2:
        return None
    floor = grid.clearance_m > radius_m
    shown = _seen(world, grid, path[:: round(1.0 / STEP_M)])
    return path if np.mean(shown[floor]) >= _SHOWN_SHARE else None


def _seen(world: World, grid: ClearanceGrid, positions: Array) -> NDArray[np.bool_]:
    """The cells of a grid that a beam from one of (n, 2) positions crosses."""
    angles = np.radians(np.arange(0.0, 360.0, 0.5))
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    steps = np.arange(0.0, _SHOWN_M, grid.cell_m)
    seen: NDArray[np.bool_] = np.zeros(grid.clearance_m.shape, dtype=np.bool_)
    for position in positions:
        ranges = cast(np.broadcast_to(position, directions.shape), angles, world.segments_m)
        ends = position + steps[:, None, None] * directions
        cells = ends[steps[:, None] < ranges]
        column, row = np.rint((cells - grid.origin_m) / grid.cell_m).astype(np.int64).T
        seen[row, column] = True
    return seen


class PathFollower:
    """Pure pursuit round and round a closed way, by nothing but the poses it is given.

    The lookahead point follows the progress along the way, so that crossings do not confuse it.
    """

    def __init__(self, path_m: Array) -> None:
        """``path_m``: (n, 2), 5 cm apart, in the frame of the poses to come."""
        self._path = readonly(path_m)
        self._progress = 0

    @property
    def laps(self) -> float:
        """Rounds done so far."""
        return self._progress / len(self._path)

    def steer(self, pose: Pose2) -> tuple[float, float]:
        """The command (m/s, rad/s) from a pose in the way's frame."""
        self._progress += self._steps_ahead(pose)
        aim = self._path[(self._progress + round(_LOOKAHEAD_M / STEP_M)) % len(self._path)]
        to_aim = pose.inverse() @ aim[None]
        bearing_rad = wrap_angle(math.atan2(to_aim[0, 1], to_aim[0, 0]))
        if abs(bearing_rad) > _TURN_ON_SPOT_RAD:
            return 0.0, math.copysign(_TURN_RADPS, bearing_rad)
        v_mps = _CRUISE_MPS * max(0.2, 1.0 - abs(bearing_rad) / _TURN_ON_SPOT_RAD)
        omega_radps = 2.0 * v_mps * math.sin(bearing_rad) / max(math.hypot(*to_aim[0]), 0.2)
        return v_mps, min(max(omega_radps, -_TURN_RADPS), _TURN_RADPS)

    def skip(self, way_m: float) -> Pose2:
        """Go on from so much further along the way: the pose there, looking along it."""
        self._progress += round(way_m / STEP_M)
        here, ahead = (
            self._path[(self._progress + steps) % len(self._path)]
            for steps in (0, round(_LOOKAHEAD_M / STEP_M))
        )
        return Pose2(float(here[0]), float(here[1]), math.atan2(*(ahead - here)[::-1]))

    def _steps_ahead(self, pose: Pose2) -> int:
        """To the nearest point of the next metre: never back, never over to another branch."""
        ahead = (self._progress + np.arange(round(1.0 / STEP_M))) % len(self._path)
        return int(np.argmin(np.hypot(*(self._path[ahead] - pose.translation).T)))
