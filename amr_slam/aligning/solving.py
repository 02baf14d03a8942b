"""Gauss-Newton over pairs of poses, with the pairs that contradict the others left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.aligning.pairs import PosePairs
from amr_slam.geometry import Array, wrap_angle

SHIFT: Final = (0, 1)
TURN: Final = 2
MARKER: Final = (3, 4)
YAW: Final = 5
CLOCK: Final = 6
SCALE: Final = 7
_UNKNOWNS: Final = 8

_ROUNDS: Final = 30
_STEPS: Final = 4
_OUTLIER: Final = 5.0
"""A pair that is off by so many standard deviations contradicts the others ..."""
_OUTLIER_M, _OUTLIER_RAD = 0.03, math.radians(3.0)
"""... if it is off by this much at least ..."""
_STRANGER_M: Final = 0.5
"""... and in any case if by this much."""
_SIGMA_M, _SIGMA_RAD = 1e-3, math.radians(0.02)
"""Nobody measures better than this."""
_FEW_SIGMA_M: Final = 0.01
"""What is taken for the noise where too few pairs tell it."""
_BLOCKS: Final = 12
_LEAST_AGREEING: Final = 2
_RAYLEIGH: Final = 1.1774
"""Median of the length of two normal errors of standard deviation 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """One set of unknowns and what it leaves."""

    values: Array
    """(8,) shift x, y m, turn rad, marker x, y m, its heading rad, clock s, scale - 1."""
    active: tuple[int, ...]
    """The unknowns that were estimated."""
    covariance: Array
    """(k, k) of these, the shift's that of the middle of the pairs."""
    offsets_m: Array
    """(n, 2)."""
    offsets_rad: Array
    """(n,)."""
    agrees: NDArray[np.bool_]
    """(n,)."""
    sigma_m: float
    sigma_rad: float

    @staticmethod
    def beginning(pairs: PosePairs, values: Array, median_m: float) -> Solved:
        """Before the first step: pairs within a few medians agree."""
        offsets_m, offsets_rad = residuals(pairs, values)
        sigma_m = max(median_m / _RAYLEIGH, _SIGMA_M)
        sizes_m = np.hypot(*offsets_m.T)
        agrees = sizes_m <= _most_m(sigma_m)
        if int(agrees.sum()) < _LEAST_AGREEING:
            agrees = sizes_m <= np.median(sizes_m)
        return Solved(
            values=values,
            active=(),
            covariance=np.zeros((0, 0)),
            offsets_m=offsets_m,
            offsets_rad=offsets_rad,
            agrees=agrees,
            sigma_m=sigma_m,
            sigma_rad=max(_spread_rad(offsets_rad[agrees]), _SIGMA_RAD),
        )

    def sigma(self, unknowns: Sequence[int]) -> float:
        """Standard deviation of some of the unknowns, the mean of more than one."""
        rows = [self.active.index(unknown) for unknown in unknowns]
        return math.sqrt(float(np.mean(np.diag(self.covariance)[rows])))


def solve(pairs: PosePairs, active: Sequence[int], begun: Solved, *, ordered: bool) -> Solved:
    """The active unknowns by least squares over the pairs that agree, until these stay the same."""
    solved = replace(begun, active=tuple(active))
    middle = pairs.map[begun.agrees, :2].mean(axis=0)
    for _ in range(_ROUNDS):
        values = solved.values
        for _ in range(_STEPS):
            values = values + _step(pairs, values, solved, middle)
        before, solved = solved.agrees, _judged(pairs, values, solved)
        if np.array_equal(before, solved.agrees):
            break
    return replace(solved, covariance=_covariance(pairs, solved, middle, ordered=ordered))


def residuals(pairs: PosePairs, values: Array) -> tuple[Array, Array]:
    """(n, 2) m and (n,) rad: what the site says, less what the unknowns make of the map's pose."""
    predicted, headings, _ = _predicted(pairs, values)
    off = pairs.site[:, 2] - headings
    return pairs.site[:, :2] - predicted, np.where(np.isfinite(off), wrap_angle(off), np.nan)


def _predicted(pairs: PosePairs, values: Array) -> tuple[Array, Array, dict[str, Array]]:
    """Positions (n, 2) and headings (n,) of the marker in the site's frame, and parts of them."""
    x, y, turn, mx, my, yaw, clock, scale = values
    phi = np.where(np.isfinite(pairs.map[:, 2]), pairs.map[:, 2], 0.0)
    way = np.zeros((len(pairs), 2))
    omega = np.zeros(len(pairs))
    if pairs.twists is not None:
        way, omega = _turned(pairs.twists[:, :2], phi), pairs.twists[:, 2]
    base = _turned(pairs.map[:, :2] + clock * way, turn)
    arm = _turned(np.array([[mx, my]]), turn + phi + clock * omega)
    position = np.array([x, y]) + (1.0 + scale) * (base + arm)
    headings = turn + pairs.map[:, 2] + clock * omega + yaw
    parts = {
        "body": base + arm,
        "arm": arm,
        "speed": _turned(way, turn),
        "omega": omega,
        "ahead": turn + phi + clock * omega,
    }
    return position, headings, parts


def _turned(points: Array, theta: float | Array) -> Array:
    c, s = np.cos(theta), np.sin(theta)
    x, y = points[:, 0], points[:, 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=1)


def _jacobians(pairs: PosePairs, values: Array, middle: Array) -> tuple[Array, Array]:
    """(n, 2, 8) and (n, 8) derivatives of the predicted positions and headings. The shift is that
    of ``middle`` (2,) of the map, so that it and the turn are told apart."""
    _, _, parts = _predicted(pairs, values)
    pivot = _turned(middle[None], float(values[TURN]))
    body, ahead, omega = parts["body"] - pivot, parts["ahead"], parts["omega"]
    place = np.zeros((len(pairs), 2, _UNKNOWNS))
    place[:, 0, 0] = place[:, 1, 1] = 1.0
    place[:, :, TURN] = np.stack([-body[:, 1], body[:, 0]], axis=1)
    place[:, 0, 3], place[:, 0, 4] = np.cos(ahead), -np.sin(ahead)
    place[:, 1, 3], place[:, 1, 4] = np.sin(ahead), np.cos(ahead)
    arm = parts["arm"]
    swing = omega[:, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    place[:, :, CLOCK] = parts["speed"] + swing
    place[:, :, SCALE] = body
    heading = np.zeros((len(pairs), _UNKNOWNS))
    heading[:, TURN] = heading[:, YAW] = 1.0
    heading[:, CLOCK] = omega
    return place, heading


def _rows(pairs: PosePairs, values: Array, solved: Solved, middle: Array) -> tuple[Array, Array]:
    """The weighted system (m, k), (m,) of the pairs that agree, row by row of each pair: x, y and,
    where there is one, its heading."""
    place, heading = _jacobians(pairs, values, middle)
    off_m, off_rad = residuals(pairs, values)
    columns = list(solved.active)
    tables = np.concatenate(
        [place / solved.sigma_m, heading[:, None, :] / solved.sigma_rad], axis=1
    )[:, :, columns]
    off = np.concatenate([off_m / solved.sigma_m, off_rad[:, None] / solved.sigma_rad], axis=1)
    silent = ~np.isfinite(off)
    off, tables = np.where(silent, 0.0, off), np.where(silent[:, :, None], 0.0, tables)
    return tables[solved.agrees], off[solved.agrees]


def _step(pairs: PosePairs, values: Array, solved: Solved, middle: Array) -> Array:
    tables, off = _rows(pairs, values, solved, middle)
    found = np.linalg.lstsq(tables.reshape(-1, tables.shape[2]), off.ravel(), rcond=1e-10)[0]
    step = np.zeros(_UNKNOWNS)
    step[list(solved.active)] = found
    # From the shift of the middle back to that of the origin.
    turn, stretched = float(values[TURN]), 1.0 + float(values[SCALE])
    before = stretched * _turned(middle[None], turn)
    after = (stretched + step[SCALE]) * _turned(middle[None], turn + step[TURN])
    step[list(SHIFT)] += (before - after)[0]
    return step


def _judged(pairs: PosePairs, values: Array, solved: Solved) -> Solved:
    """Noise and agreement anew."""
    off_m, off_rad = residuals(pairs, values)
    size, count = np.hypot(*off_m.T), int(solved.agrees.sum())
    # Unknowns take up part of the residuals: few pairs look better than they are.
    freedom = 2.0 * count / max(2.0 * count - len(solved.active), 1.0)
    sigma_m = float(np.median(size[solved.agrees])) / _RAYLEIGH * math.sqrt(freedom)
    if 2 * count - len(solved.active) < 4:
        sigma_m = max(sigma_m, _FEW_SIGMA_M)
    sigma_m = max(sigma_m, _SIGMA_M)
    sigma_rad = max(_spread_rad(off_rad[solved.agrees]), _SIGMA_RAD)
    agrees = size <= _most_m(sigma_m)
    agrees &= ~(np.abs(off_rad) > max(_OUTLIER * sigma_rad, _OUTLIER_RAD))
    if int(agrees.sum()) < max(_LEAST_AGREEING, (len(solved.active) + 1) // 2):
        agrees = solved.agrees
    return replace(
        solved,
        values=values,
        offsets_m=off_m,
        offsets_rad=off_rad,
        agrees=agrees,
        sigma_m=sigma_m,
        sigma_rad=sigma_rad,
    )


def _most_m(sigma_m: float) -> float:
    return min(max(_OUTLIER * sigma_m, _OUTLIER_M), _STRANGER_M)


def _spread_rad(off_rad: Array) -> float:
    known = off_rad[np.isfinite(off_rad)]
    return 1.4826 * float(np.median(np.abs(known))) if len(known) else 0.0


def _covariance(pairs: PosePairs, solved: Solved, middle: Array, *, ordered: bool) -> Array:
    """Of the active unknowns. Neighbouring poses share their errors: blocks of them tell by how
    much the plain covariance, which takes each for a witness of its own, is too small."""
    tables, off = _rows(pairs, solved.values, solved, middle)
    size = tables.shape[2]
    information = np.einsum("nij,nik->jk", tables, tables)
    # Of like size first: what nothing tells beside the others is then seen, and very unsure.
    unit = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    strength, axes = np.linalg.eigh(information * np.outer(unit, unit))
    plain = (axes / np.maximum(strength, 1e-10)) @ axes.T * np.outer(unit, unit)
    if not ordered or len(tables) < 4 * _BLOCKS:
        return np.asarray(plain)
    slopes = np.einsum("nij,ni->nj", tables, off)
    sums = np.stack([block.sum(axis=0) for block in np.array_split(slopes, _BLOCKS)])
    spread = _BLOCKS / (_BLOCKS - 1.0) * sums.T @ sums
    return np.asarray(max(1.0, float(np.trace(plain @ spread)) / size) * plain)
