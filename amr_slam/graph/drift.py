"""How far off the newest node may be, as each older one sees it.

Errors add up along the ways and loops that tie two nodes: a little of place and of heading with
each metre, and an error of heading displaces all that lies beyond it. What is told is a bound:
only the shortest tie counts, however many others there are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.geometry import Array
from amr_slam.graph.posegraph import Edge
from amr_slam.params import DriftParams

_LEAST_M = 0.05
"""A turn in place counts as this much way, and a loop too."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drift:
    """What the newest node may be off by, one row for each node that it is compared with."""

    ways_m: Array
    """(n,) shortest way between the two, through loops where these are shorter."""
    headings_rad: Array
    """(n,) standard deviation."""
    places_m2: Array
    """(n, 2, 2) covariance, in the axes of the map."""


class Ties:
    """The ways that nodes are tied by."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._ways_m: list[float] = []

    def add(self, edges: Sequence[Edge]) -> None:
        """Further steps and loops."""
        for edge in edges:
            way_m = 0.0 if edge.loop else math.hypot(edge.delta.x_m, edge.delta.y_m)
            self._starts.append(edge.start)
            self._ends.append(edge.end)
            self._ways_m.append(max(way_m, _LEAST_M))

    def drift(self, poses: Array, params: DriftParams) -> Drift:
        """Of the newest of all nodes' poses (n, 3). Takes about a microsecond a node."""
        count = len(poses)
        graph = scipy.sparse.csr_array(
            (self._ways_m, (self._starts, self._ends)), shape=(count, count)
        )
        everywhere, before = scipy.sparse.csgraph.dijkstra(
            graph, directed=False, indices=[count - 1], return_predecessors=True
        )
        ways_m, parents = everywhere[0], before[0]
        parents = np.where(parents < 0, count - 1, parents).astype(np.intp)
        # Where the heading's error of each tie turns what lies beyond, seen from the newest node.
        at = 0.5 * (poses[:, :2] + poses[parents, :2]) - poses[-1, :2]
        turn = params.heading_radpsqrtm**2 * (ways_m - ways_m[parents])
        moments = np.column_stack([np.ones(count), at, at[:, 0] ** 2, at[:, 0] * at[:, 1],
                                   at[:, 1] ** 2]) * turn[:, None]  # fmt: skip
        moments = _summed(moments, parents)
        beyond = poses[:, :2] - poses[-1, :2]
        return Drift(
            ways_m=ways_m,
            headings_rad=np.sqrt(moments[:, 0]),
            places_m2=_places(moments, beyond, (params.scale * ways_m) ** 2 + params.place_m**2),
        )


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
