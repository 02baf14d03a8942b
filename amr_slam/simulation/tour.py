"""A way through a laboratory that shows all of it, and the steering along it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from amr_slam.geometry import Array, Pose2, readonly, wrap_angle
from amr_slam.simulation.grid import ClearanceGrid
from amr_slam.simulation.world import World

_CRUISE_MPS = 0.3
_TURN_RADPS = 0.8
# With its turns about 85 scans at 0.5 Hz and 0.3 m/s, as in the paper's section 3.1.
_LENGTH_M = 43.0
# Beside the hull on the planned way: what steering and a SLAM pose may be off.
_MARGIN_M = 0.15
# Further from walls than this a way gets no better.
_COMFORT_M = 0.9
_STEP_M = 0.05
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
    """A round of about 45 m through the free space for a robot of ``radius_m``.

    Raises ValueError when there is no room for one.
    """
    planner = _Planner(ClearanceGrid.of(world), radius_m + _MARGIN_M)
    path = planner.closed_path(_LENGTH_M)
    ahead = path[round(_LOOKAHEAD_M / _STEP_M)] - path[0]
    start = Pose2(float(path[0, 0]), float(path[0, 1]), math.atan2(ahead[1], ahead[0]))
    return Tour(world_from_map=start, path_m=path)


class _Planner:
    """Shortest comfortable ways between cells of a clearance grid."""

    def __init__(self, grid: ClearanceGrid, needed_m: float) -> None:
        self._grid = grid
        self._needed_m = needed_m
        clearance = grid.clearance_m.ravel()
        graph = _cell_graph(grid, needed_m)
        _, label = csgraph.connected_components(graph, directed=False)
        passable = clearance >= needed_m
        if not passable.any():
            raise ValueError("no room for the robot")
        largest = np.argmax(np.bincount(label[passable]))
        self._cells = np.flatnonzero(passable & (label == largest))
        self._graph = graph

    def closed_path(self, length_m: float) -> Array:
        """(n, 2) through the places furthest from each other, as many as the length takes."""
        clearance = self._grid.clearance_m.ravel()
        roomy = self._cells[clearance[self._cells] >= self._needed_m + 0.2]
        places = [int(roomy[np.argmax(clearance[roomy])])]
        distances: list[Array] = []
        parents: list[NDArray[np.int32]] = []
        best = None
        while len(places) < 24:
            distance, parent = csgraph.dijkstra(
                self._graph, directed=False, indices=[places[-1]], return_predecessors=True
            )
            distances.append(distance[0])
            parents.append(parent[0])
            if len(places) >= 3:
                order = _round_trip(np.array(distances)[:, places])
                best = self._path(places, parents, order)
                if _STEP_M * len(best) >= length_m:
                    break
            nearest = np.min(np.array(distances)[:, roomy], axis=0)
            places.append(int(roomy[np.argmax(nearest)]))
        if best is None:
            raise ValueError("no room for a tour")
        return best

    def _path(self, places: list[int], parents: list[NDArray[np.int32]], order: list[int]) -> Array:
        cells: list[int] = []
        for i, j in itertools.pairwise([*order, order[0]]):
            back = [places[j]]
            while back[-1] != places[i]:
                back.append(int(parents[i][back[-1]]))
            cells += back[:0:-1]
        points = np.array([self._grid.centre(cell) for cell in cells])
        return self._smooth(_resample(points))

    def _smooth(self, path: Array) -> Array:
        """Corners of the grid rounded off wherever the room allows it."""
        window = round(0.6 / _STEP_M) | 1
        kernel = np.hanning(window + 2)[1:-1]
        kernel /= kernel.sum()
        half = window // 2
        padded = np.concatenate([path[-half:], path, path[:half]])
        smooth = np.column_stack([np.convolve(axis, kernel, "valid") for axis in padded.T])
        keeps_room = self._grid.at(smooth) >= self._needed_m
        return _resample(np.where(keeps_room[:, None], smooth, path))


def _cell_graph(grid: ClearanceGrid, needed_m: float) -> sparse.csr_array:
    """Eight neighbours; narrow places cost up to three times their length."""
    clearance = grid.clearance_m
    passable = clearance >= needed_m
    discomfort = np.clip((_COMFORT_M - clearance) / (_COMFORT_M - needed_m), 0.0, 1.0)
    index = np.arange(clearance.size, dtype=np.int64).reshape(clearance.shape)
    rows, columns = clearance.shape
    starts: list[NDArray[np.int64]] = []
    ends: list[NDArray[np.int64]] = []
    costs: list[Array] = []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = np.s_[: rows - dy, max(0, -dx) : columns - max(0, dx)]
        b = np.s_[dy:, max(0, dx) : columns + min(0, dx)]
        both = passable[a] & passable[b]
        length = grid.cell_m * math.hypot(dy, dx)
        starts.append(index[a][both])
        ends.append(index[b][both])
        costs.append(length * (1.0 + discomfort[a] + discomfort[b])[both])
    pairs = (np.concatenate(starts), np.concatenate(ends))
    return sparse.csr_array((np.concatenate(costs), pairs), shape=(clearance.size,) * 2)


def _round_trip(distances: Array) -> list[int]:
    """Order of all places from the first, improved by reversals (2-opt) until none helps."""
    count = len(distances)
    order = [0]
    while len(order) < count:
        rest = [i for i in range(count) if i not in order]
        order.append(min(rest, key=lambda i: float(distances[order[-1], i])))
    improved = True
    while improved:
        improved = False
        for i, j in itertools.combinations(range(1, count), 2):
            a, b, c, d = order[i - 1], order[i], order[j], order[(j + 1) % count]
            gain = distances[a, b] + distances[c, d] - distances[a, c] - distances[b, d]
            if gain > 1e-9:
                order[i : j + 1] = order[i : j + 1][::-1]
                improved = True
    return order


def _resample(points: Array) -> Array:
    """A closed way with even steps."""
    closed = np.concatenate([points, points[:1]])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    even = np.linspace(0.0, way[-1], max(4, round(way[-1] / _STEP_M)), endpoint=False)
    return np.column_stack([np.interp(even, way, axis) for axis in closed.T])


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
        aim = self._path[(self._progress + round(_LOOKAHEAD_M / _STEP_M)) % len(self._path)]
        to_aim = pose.inverse() @ aim[None]
        bearing_rad = wrap_angle(math.atan2(to_aim[0, 1], to_aim[0, 0]))
        if abs(bearing_rad) > _TURN_ON_SPOT_RAD:
            return 0.0, math.copysign(_TURN_RADPS, bearing_rad)
        v_mps = _CRUISE_MPS * max(0.2, 1.0 - abs(bearing_rad) / _TURN_ON_SPOT_RAD)
        omega_radps = 2.0 * v_mps * math.sin(bearing_rad) / max(math.hypot(*to_aim[0]), 0.2)
        return v_mps, min(max(omega_radps, -_TURN_RADPS), _TURN_RADPS)

    def _steps_ahead(self, pose: Pose2) -> int:
        """To the nearest point of the next metre: never back, never over to another branch."""
        ahead = (self._progress + np.arange(round(1.0 / _STEP_M))) % len(self._path)
        return int(np.argmin(np.hypot(*(self._path[ahead] - pose.translation).T)))
