"""The pose graph: where the scans were taken, given what is known of pairs of them.

Least squares over the poses of all scans at once (Grisetti et al., IEEE ITS Magazine 2(4), 2010),
solved sparsely by Levenberg and Marquardt's method. A loop edge may be false: its weight falls with
its error (Geman and McClure), so that one false edge cannot bend what many others hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2, readonly, wrap_angle

_ITERATIONS: Final = 20
_SMALL: Final = 1e-4
"""A step below this (m, rad) ends the iteration."""
_KERNEL_D2: Final = 16.27
"""Squared Mahalanobis distance at which a loop edge has a quarter of its weight in the end: what
chance exceeds once in a thousand times."""
_NARROWER: Final = 16.0
_WIDEST: Final = 7
"""Before that, one solution after the other under kernels this much wider each, and so often at
most: a true loop after a long way must pull before it can be told from a false one."""
_GAIN: Final = 1e-4
"""Under these, a solution that gets better by a smaller share of its cost is good enough."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """What is known of one scan's pose in the base frame of another one."""

    start: int
    """Row of the earlier scan."""
    end: int
    delta: Pose2
    """``start_from_end``."""
    information: Array
    """(3, 3) of delta's (x, y, theta), in the start's frame."""
    loop: bool = False
    """True: found by comparing places, and so perhaps wrong."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "information", readonly(self.information))


def optimize(poses: Array, edges: Sequence[Edge], newest: int | None = None) -> Array:
    """The poses (n, 3) that agree best with all edges, from ``poses``, of which the first one stays
    where it is. Edges must tie each to it. Deterministic.

    ``newest``: so many edges at the end are new to these poses; None: all are.
    """
    stack = _Stack(edges, len(poses))
    found = np.array(poses, dtype=np.float64)
    strain = stack.d2(found)[-newest if newest else None :]
    ratio = float(strain.max(initial=0.0)) / _KERNEL_D2
    wider = min(math.ceil(math.log(max(ratio, 1.0), _NARROWER)), _WIDEST)
    for power in range(wider, -1, -1):
        stack.kernel_d2 = _KERNEL_D2 * _NARROWER**power
        found = _descend(stack, found, _GAIN if power else 0.0)
    return found


def strains(poses: Array, edges: Sequence[Edge]) -> Array:
    """(m,) squared Mahalanobis distance between what each edge says and where the poses (n, 3)
    are."""
    return _Stack(edges, len(poses)).d2(poses)


def _descend(stack: _Stack, found: Array, gain: float) -> Array:
    damping, cost = 1e-6, stack.cost(found)
    for _ in range(_ITERATIONS):
        normal, gradient = stack.normal_equations(found)
        damped = scipy.sparse.csc_array(
            normal + scipy.sparse.diags_array(damping * normal.diagonal())
        )
        step = scipy.sparse.linalg.spsolve(damped, -gradient).reshape(-1, 3)
        tried = found.copy()
        tried[1:] += step
        tried[:, 2] = wrap_angle(tried[:, 2])
        tried_cost = stack.cost(tried)
        if tried_cost > cost:
            damping *= 10.0
            continue
        enough = cost - tried_cost < gain * cost or np.abs(step).max(initial=0.0) < _SMALL
        found, cost, damping = tried, tried_cost, max(0.1 * damping, 1e-9)
        if enough:
            break
    return found


class _Stack:
    """All edges as arrays."""

    def __init__(self, edges: Sequence[Edge], count: int) -> None:
        self._count = count
        self.kernel_d2 = math.inf
        self._start = np.array([edge.start for edge in edges], dtype=np.intp)
        self._end = np.array([edge.end for edge in edges], dtype=np.intp)
        self._delta = np.array([edge.delta.as_array() for edge in edges]).reshape(-1, 3)
        self._information = np.array([edge.information for edge in edges]).reshape(-1, 3, 3)
        self._loop = np.array([edge.loop for edge in edges], dtype=np.bool_)

    def residuals(self, poses: Array) -> Array:
        """(m, 3) what each edge's delta is off by, in the start's frame."""
        a, b = poses[self._start], poses[self._end]
        cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, 0], (b - a)[:, 1]
        off = np.stack([cos * dx + sin * dy, cos * dy - sin * dx, b[:, 2] - a[:, 2]], axis=1)
        off -= self._delta
        off[:, 2] = wrap_angle(off[:, 2])
        return off

    def d2(self, poses: Array) -> Array:
        off = self.residuals(poses)
        return np.asarray(np.sum(off * _times(self._information, off), axis=1))

    def cost(self, poses: Array) -> float:
        d2 = self.d2(poses)
        return float(np.sum(np.where(self._loop, d2 * self.kernel_d2 / (self.kernel_d2 + d2), d2)))

    def normal_equations(self, poses: Array) -> tuple[scipy.sparse.csc_array, Array]:
        """(3(n-1), 3(n-1)) and (3(n-1),): of all poses but the first."""
        a, b = poses[self._start], poses[self._end]
        off = self.residuals(poses)
        pull = _times(self._information, off)
        d2 = np.sum(off * pull, axis=1)
        weight = np.where(self._loop, (self.kernel_d2 / (self.kernel_d2 + d2)) ** 2, 1.0)
        pull = weight[:, None] * pull
        information = weight[:, None, None] * self._information
        cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, 0], (b - a)[:, 1]
        by_start = np.zeros((len(off), 3, 3))
        by_end = np.zeros((len(off), 3, 3))
        by_end[:, 0, 0], by_end[:, 0, 1] = cos, sin
        by_end[:, 1, 0], by_end[:, 1, 1] = -sin, cos
        by_end[:, 2, 2] = 1.0
        by_start[:, :2, :2] = -by_end[:, :2, :2]
        by_start[:, 0, 2] = cos * dy - sin * dx
        by_start[:, 1, 2] = -cos * dx - sin * dy
        by_start[:, 2, 2] = -1.0
        sides = (
            (self._start, by_start.transpose(0, 2, 1), information @ by_start),
            (self._end, by_end.transpose(0, 2, 1), information @ by_end),
        )
        size = 3 * self._count
        gradient = np.zeros(size)
        rows, columns, values = [], [], []
        for row, jacobian, _ in sides:
            where = (3 * row[:, None] + np.arange(3)).ravel()
            part = _times(jacobian, pull)
            gradient += np.bincount(where, weights=part.ravel(), minlength=size)
            for column, _, other in sides:
                block = jacobian @ other
                rows.append(_spread(row, 1))
                columns.append(_spread(column, 0))
                values.append(block.ravel())
        normal = scipy.sparse.csc_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
            shape=(size, size),
        )
        return normal[3:, 3:], gradient[3:]


def _times(matrices: Array, vectors: Array) -> Array:
    """(m, 3) each matrix of (m, 3, 3) by its vector."""
    return np.asarray(np.matmul(matrices, vectors[..., None])[..., 0])


def _spread(nodes: NDArray[np.intp], axis: int) -> NDArray[np.intp]:
    """(9 m,) rows (axis 1) or columns (axis 0) of the 3 x 3 blocks of these nodes."""
    within = np.repeat(np.arange(3), 3) if axis == 1 else np.tile(np.arange(3), 3)
    return np.asarray((3 * nodes[:, None] + within).ravel())
