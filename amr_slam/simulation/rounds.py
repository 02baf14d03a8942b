"""A round that comes near every place of a large world or one of many rooms."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from amr_slam.geometry import Array
from amr_slam.simulation.grid import ClearanceGrid
from amr_slam.simulation.planning import cell_graph, smooth

# No roomy place is further from all stops of the round; narrow ways count up to three times.
_REACH_M = 5.0
# A stop has this much more room than the robot needs.
_ROOM_M = 0.2


def long_round(grid: ClearanceGrid, needed_m: float) -> Array:
    """(n, 2) closed way in steps of 5 cm through the largest connected part of the floor.

    ``needed_m``: clearance that every place on it has. Raises ValueError where none has it.
    """
    cells, graph = _largest_part(grid, needed_m)
    clearance = grid.clearance_m.ravel()[cells]
    stops = _stops(graph, clearance, needed_m + _ROOM_M)
    if len(stops) < 3:
        raise ValueError("no room for a tour")
    nodes = _through(stops, graph)
    return smooth(np.array([grid.centre(int(cell)) for cell in cells[nodes]]), grid, needed_m)


def _largest_part(
    grid: ClearanceGrid, needed_m: float
) -> tuple[NDArray[np.int64], sparse.csr_array]:
    """Flat indices of the cells, and the ways between these as a symmetric graph."""
    passable = grid.clearance_m.ravel() >= needed_m
    if not passable.any():
        raise ValueError("no room for the robot")
    cells = np.flatnonzero(passable)
    one_way = cell_graph(grid, needed_m)[cells][:, cells]
    graph = sparse.csr_array(one_way + one_way.T)
    _, label = csgraph.connected_components(graph, directed=False)
    largest = np.flatnonzero(label == np.argmax(np.bincount(label)))
    return cells[largest], sparse.csr_array(graph[largest][:, largest])


def _stops(graph: sparse.csr_array, clearance: Array, roomy_m: float) -> list[int]:
    """Nodes such that each roomy one is near to some of them: always the furthest one next."""
    roomy = np.flatnonzero(clearance >= min(roomy_m, float(clearance.max())))
    stops = [int(np.argmax(clearance))]
    nearest = csgraph.dijkstra(graph, indices=[stops[0]])[0]
    while True:
        furthest = int(roomy[np.argmax(nearest[roomy])])
        if nearest[furthest] <= _REACH_M and len(stops) >= 3:
            return stops
        if furthest in stops:  # a place so small that there is nothing else
            return stops
        stops.append(furthest)
        # No node can come nearer to a stop than the furthest one was.
        limit = float(nearest[furthest])
        distance = csgraph.dijkstra(graph, indices=[furthest], limit=limit)[0]
        nearest = np.minimum(nearest, distance)


def _through(stops: list[int], graph: sparse.csr_array) -> list[int]:
    """Nodes of a closed way through all stops, short by their distances along the ways."""
    distance, parent, source = csgraph.dijkstra(
        graph, indices=stops, min_only=True, return_predecessors=True
    )
    number = np.full(graph.shape[0], -1)
    number[stops] = np.arange(len(stops))
    owner = number[source]
    # Where the neighbourhoods of two stops meet, a leg leads from one to the other.
    pairs = sparse.coo_array(graph)
    a, b = pairs.coords
    border = owner[a] < owner[b]
    a, b, step = a[border], b[border], pairs.data[border]
    length = distance[a] + step + distance[b]
    legs: dict[tuple[int, int], tuple[float, int, int]] = {}
    for i in np.argsort(length, kind="stable"):
        key = (int(owner[a[i]]), int(owner[b[i]]))
        legs.setdefault(key, (float(length[i]), int(a[i]), int(b[i])))
    count = len(stops)
    rows, columns = np.array(list(legs)).T
    lengths = [leg[0] for leg in legs.values()]
    net = sparse.csr_array((lengths, (rows, columns)), shape=(count, count))
    between, via = csgraph.dijkstra(net, directed=False, return_predecessors=True)
    order = _round_trip(between)

    nodes: list[int] = []
    for start, end in itertools.pairwise([*order, order[0]]):
        chain = [end]
        while chain[-1] != start:
            chain.append(int(via[start, chain[-1]]))
        for i, j in itertools.pairwise(chain[::-1]):
            _, first, second = legs[min(i, j), max(i, j)]
            leg = [*_back(first, parent)[::-1], *_back(second, parent)]
            nodes += (leg if i < j else leg[::-1])[:-1]
    return nodes


def _back(node: int, parent: NDArray[np.int32]) -> list[int]:
    """From a node to the stop that is nearest to it."""
    way = [node]
    while parent[way[-1]] >= 0:
        way.append(int(parent[way[-1]]))
    return way


def _round_trip(distances: Array) -> list[int]:
    """Order of all stops: the nearest next, then reversals (2-opt) until none makes it shorter."""
    count = len(distances)
    order = np.zeros(count, dtype=np.int64)
    left = np.ones(count, dtype=np.bool_)
    left[0] = False
    for k in range(1, count):
        order[k] = np.argmin(np.where(left, distances[order[k - 1]], np.inf))
        left[order[k]] = False
    improved = True
    while improved:
        improved = False
        for i in range(1, count - 1):
            ends = np.arange(i + 1, count)
            before, first = order[i - 1], order[i]
            last, after = order[ends], order[(ends + 1) % count]
            gain = distances[before, first] + distances[last, after]
            gain = gain - distances[before, last] - distances[first, after]
            best = int(np.argmax(gain))
            if gain[best] > 1e-9:
                order[i : ends[best] + 1] = order[i : ends[best] + 1][::-1]
                improved = True
    return [int(stop) for stop in order]
