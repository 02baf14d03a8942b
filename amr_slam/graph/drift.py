"""How far off the newest node may be, as each older one sees it.

Errors add up along the ways and loops that tie two nodes: a little of place and of heading with
each metre, more where a step was known less well than that, and an error of heading displaces all
that lies beyond it. What is told is a bound: only the surest tie counts, however many others there
are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.geometry import Array, inverse_matrix
from amr_slam.graph.posegraph import BEND, Edge
from amr_slam.params import DriftParams

_LEAST_M = 0.05
"""A turn in place counts as this much way, and a loop too."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drift:
    """What the newest node may be off by, one row for each node that it is compared with."""

    ways_m: Array
    """(n,) way between the two by the surest tie, through loops where these are surer. A step that
    nothing but the wheels knew is as long as the way that would lead as far astray."""
    headings_rad: Array
    """(n,) standard deviation."""
    places_m2: Array
    """(n, 2, 2) covariance, in the axes of the map."""


def astray_m(edge: Edge, params: DriftParams) -> float:
    """The way that would make the heading as unsure as what the edge itself does not know of it;
    0 where that is no more than scans that are registered in the same piece share."""
    unknown_rad2 = float(inverse_matrix(edge.information)[2, 2] - BEND[2, 2])
    way_m = unknown_rad2 / params.heading_radpsqrtm**2
    return way_m if way_m > params.shared_m else 0.0


class Ties:
    """The ways that nodes are tied by."""

    def __init__(self, params: DriftParams) -> None:
        self._params = params
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._ways_m: list[float] = []
        self._astray_m: list[float] = []
        self._places_m2: list[float] = []

    def add(self, edges: Sequence[Edge]) -> None:
        """Further steps and loops."""
        for edge in edges:
            way_m = 0.0 if edge.loop else math.hypot(edge.delta.x_m, edge.delta.y_m)
            way_m = max(way_m, _LEAST_M)
            unknown_m2 = inverse_matrix(edge.information)[:2, :2] - BEND[:2, :2]
            place_m2 = float(np.linalg.eigvalsh(unknown_m2)[-1])
            self._starts.append(edge.start)
            self._ends.append(edge.end)
            self._ways_m.append(way_m)
            self._astray_m.append(max(way_m, astray_m(edge, self._params)))
            self._places_m2.append(place_m2 if place_m2 > self._params.place_m**2 else 0.0)

    def drift(self, poses: Array) -> Drift:
        """Of the newest of all nodes' poses (n, 3). Takes about a microsecond a node."""
        count, params = len(poses), self._params
        pairs, ties = self._surest(count)
        graph = scipy.sparse.csr_array(
            (np.array(self._astray_m)[ties], (pairs // count, pairs % count)), shape=(count, count)
        )
        everywhere, before = scipy.sparse.csgraph.dijkstra(
            graph, directed=False, indices=[count - 1], return_predecessors=True
        )
        ways_m, parents = everywhere[0], before[0]
        nodes = np.arange(count)
        parents = np.where(parents < 0, nodes, parents).astype(np.intp)
        last = np.minimum(nodes, parents) * count + np.maximum(nodes, parents)
        last = ties[np.searchsorted(pairs, last).clip(max=len(pairs) - 1)]
        # Where the heading's error of each tie turns what lies beyond, seen from the newest node.
        at = 0.5 * (poses[:, :2] + poses[parents, :2]) - poses[-1, :2]
        turn = params.heading_radpsqrtm**2 * (ways_m - ways_m[parents])
        moments = np.column_stack([np.ones(count), at, at[:, 0] ** 2, at[:, 0] * at[:, 1],
                                   at[:, 1] ** 2]) * turn[:, None]  # fmt: skip
        plain = np.column_stack([np.array(self._ways_m)[last], np.array(self._places_m2)[last]])
        plain[-1] = 0.0
        sums = _summed(np.column_stack([moments, plain]), parents)
        beyond = poses[:, :2] - poses[-1, :2]
        plain_m2 = (params.scale * sums[:, 6]) ** 2 + sums[:, 7] + params.place_m**2
        return Drift(
            ways_m=ways_m,
            headings_rad=np.sqrt(sums[:, 0]),
            places_m2=_places(sums[:, :6], beyond, plain_m2),
        )

    def _surest(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
        """All pairs of nodes that are tied, as ascending numbers, and of each pair the tie that
        leads astray least."""
        pairs = np.array(self._starts, dtype=np.int64) * count + self._ends
        order = np.lexsort((np.array(self._astray_m), pairs))
        pairs, first = np.unique(pairs[order], return_index=True)
        return pairs, order[first]


def _summed(values: Array, parents: NDArray[np.intp]) -> Array:
    """(n, k) of each node and all that lead from it to the root, whose own values are zeros.

    After each turn, ``parents`` are twice as far away: the logarithm of the depth is enough."""
    for _ in range(max(len(parents) - 1, 1).bit_length()):
        values = values + values[parents]
        parents = parents[parents]
    return values


def _places(moments: Array, at: Array, plain_m2: Array) -> Array:
    """(n, 2, 2): sum of turn^2 (at - pivot)(at - pivot)^T turned by 90 degrees, and what is alike
    in all directions."""
    total, first = moments[:, 0], moments[:, 1:3]
    xx = total * at[:, 0] ** 2 - 2.0 * at[:, 0] * first[:, 0] + moments[:, 3]
    yy = total * at[:, 1] ** 2 - 2.0 * at[:, 1] * first[:, 1] + moments[:, 5]
    xy = (total * at[:, 0] * at[:, 1] - at[:, 0] * first[:, 1] - at[:, 1] * first[:, 0]
          + moments[:, 4])  # fmt: skip
    spread = np.empty((len(at), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = yy + plain_m2, xx + plain_m2
    spread[:, 0, 1] = spread[:, 1, 0] = -xy
    return spread
