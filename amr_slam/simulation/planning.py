"""Ways through the free cells of a clearance grid, and a round of a wanted length along them."""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from amr_slam.geometry import Array
from amr_slam.simulation.grid import ClearanceGrid

STEP_M: Final = 0.05
"""Between the points of a planned way."""

# Further from walls than this a way gets no better.
_COMFORT_M = 0.9


class ShortPlanner:
    """A round of a wanted length by shortest comfortable ways between cells."""

    def __init__(self, grid: ClearanceGrid, needed_m: float) -> None:
        self._grid = grid
        self._needed_m = needed_m
        clearance = grid.clearance_m.ravel()
        graph = cell_graph(grid, needed_m)
        _, label = csgraph.connected_components(graph, directed=False)
        passable = clearance >= needed_m
        if not passable.any():
            raise ValueError("no room for the robot")
        largest = np.argmax(np.bincount(label[passable]))
        self._cells = np.flatnonzero(passable & (label == largest))
        self._graph = graph

    @property
    def area_m2(self) -> float:
        """Of the largest connected part of the cells with the needed clearance."""
        return len(self._cells) * self._grid.cell_m**2

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
                if STEP_M * len(best) >= length_m:
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
        return smooth(points, self._grid, self._needed_m)


def smooth(path: Array, grid: ClearanceGrid, needed_m: float) -> Array:
    """Corners of the grid rounded off wherever the room allows it; (n, 2) in steps of STEP_M."""
    path = resample(path)
    window = round(0.6 / STEP_M) | 1
    kernel = np.hanning(window + 2)[1:-1]
    kernel /= kernel.sum()
    half = window // 2
    padded = np.concatenate([path[-half:], path, path[:half]])
    rounded = np.column_stack([np.convolve(axis, kernel, "valid") for axis in padded.T])
    keeps_room = grid.at(rounded) >= needed_m
    return resample(np.where(keeps_room[:, None], rounded, path))


def cell_graph(grid: ClearanceGrid, needed_m: float) -> sparse.csr_array:
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


def resample(points: Array) -> Array:
    """A closed way with even steps."""
    closed = np.concatenate([points, points[:1]])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    even = np.linspace(0.0, way[-1], max(4, round(way[-1] / STEP_M)), endpoint=False)
    return np.column_stack([np.interp(even, way, axis) for axis in closed.T])
