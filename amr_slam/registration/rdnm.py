"""Relative Directional Neighbour Matching: the rough pose of a scan in a map (algorithm 1).

A place is described by how far its surroundings are in each direction (RDN); a turn of the robot
is then a circular shift of that signature (eq. 2). All candidates and all rotations are compared
at once. What differs from the letter of the paper, and why: ``docs/adr/0002-rdnm.md``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array, Pose2
from amr_slam.registration import kernels
from amr_slam.registration.alignment import Target
from amr_slam.registration.casting import ranges

Single = NDArray[np.float32]
Packed = NDArray[np.uint16]

_MOST_MM = 65535

# Candidates are worked off in blocks that keep the temporaries within the cache's reach.
_BLOCK_ELEMENTS = 2_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class RdnmParams:
    """Sections, layers, and what two signatures may differ by."""

    signature: Literal["rays", "layer"] = "rays"
    """How a signature is made: the median of a scan's section against one ray into the map, or
    the paper's mean of the nearest layer for both."""
    sections: Annotated[int, Ge(8), Le(720)] = 120
    """Number of directions; the paper's alpha is 360 degrees by this."""
    layer_m: Annotated[float, Gt(0.0)] = 0.3
    """The paper's epsilon: points this much behind a section's nearest one still count."""
    shorter_m: Annotated[float, Gt(0.0)] = 0.4
    """The most that a section nearer than the map costs: somebody may stand there."""
    longer_m: Annotated[float, Gt(0.0)] = 1.2
    """The most that a section farther than the map costs: walls do not vanish."""
    unseen_m: Annotated[float, Ge(0.0)] = 0.4
    """What a seen section costs where the map knows nothing."""
    range_max_m: Annotated[float, Gt(0.0)] = 25.0
    """Points beyond say little about where the robot stands, and cost time."""
    rotations: Annotated[int, Ge(1)] = 2
    """Best rotations kept for each candidate: halls are often symmetric."""


def rdn(points_m: Array, viewpoints_m: Array, spacing_m: float, params: RdnmParams) -> Array:
    """Signatures (m, sections) in m of a point cloud (n, 2) seen from viewpoints (m, 2).

    Section ``i`` looks at angles [i, i + 1) * 2 pi / sections. Its value is the mean distance of
    the points within ``layer_m`` behind its nearest point; NaN where it holds none.
    ``spacing_m``: distance of neighbouring points on a wall (0: none assumed); a point hides the
    sections that it covers with half of that to each side, so that near walls have no gaps.
    (Algorithm 1, procedure RDN, for all viewpoints at once.)
    """
    viewpoints = np.atleast_2d(viewpoints_m)
    out = np.full((len(viewpoints), params.sections), np.nan)
    if not len(points_m):
        return out
    block = max(1, _BLOCK_ELEMENTS // len(points_m))
    for start in range(0, len(viewpoints), block):
        part = viewpoints[start : start + block]
        out[start : start + len(part)] = _rdn_block(points_m, part, spacing_m, params)
    return out


def _rdn_block(points: Array, viewpoints: Array, spacing_m: float, params: RdnmParams) -> Array:
    m, sections = len(viewpoints), params.sections
    dx = (points[:, 0] - viewpoints[:, 0:1]).astype(np.float32)
    dy = (points[:, 1] - viewpoints[:, 1:2]).astype(np.float32)
    distance = np.hypot(dx, dy)
    near = distance <= params.range_max_m
    row = np.broadcast_to(np.arange(m)[:, None], near.shape)[near]
    distance = distance[near]
    position = np.arctan2(dy[near], dx[near]) * np.float32(sections / math.tau)
    cell = row * sections + np.floor(position).astype(np.int64) % sections
    if spacing_m > 0.0:
        half = 0.5 * spacing_m / np.maximum(distance, 1e-3) * (sections / math.tau)
        wide = half > 0.25
        sides = [
            row[wide] * sections + np.floor(position[wide] + side).astype(np.int64) % sections
            for side in (-half[wide], half[wide])
        ]
        cell = np.concatenate([cell, *sides])
        distance = np.concatenate([distance, distance[wide], distance[wide]])
    nearest = np.full(m * sections, np.inf, dtype=np.float32)
    np.minimum.at(nearest, cell, distance)
    layer = distance < nearest[cell] + np.float32(params.layer_m)
    total = np.bincount(cell[layer], weights=distance[layer], minlength=m * sections)
    count = np.bincount(cell[layer], minlength=m * sections)
    with np.errstate(invalid="ignore"):
        return np.asarray((total / count).reshape(m, sections))


def of_scan(points_m: Array, params: RdnmParams) -> Array:
    """Signature (sections,) of a scan's points (n, 2) about the robot."""
    if params.signature == "rays":
        return medians(points_m, params)
    return np.asarray(rdn(points_m, np.zeros((1, 2)), 0.0, params)[0])


def of_map(target: Target, viewpoints_m: Array, params: RdnmParams) -> Packed:
    """Packed signatures (m, sections) of a map's walls seen from viewpoints (m, 2)."""
    if params.signature == "rays":
        return pack(views(target, viewpoints_m, params))
    return pack(rdn(target.points_m, viewpoints_m, target.spacing_m, params))


def views(target: Target, viewpoints_m: Array, params: RdnmParams) -> Array:
    """Signatures (m, sections) in m of the map's walls seen from viewpoints (m, 2), by one ray
    through the middle of each section; NaN where it meets nothing within ``range_max_m``.

    The same as :func:`rdn` of the walls' points, but what lies behind a wall is never seen, and
    the cost does not grow with the map.
    """
    angles = (np.arange(params.sections) + 0.5) * (math.tau / params.sections)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    count = len(viewpoints_m)
    seen = ranges(
        target,
        np.repeat(viewpoints_m, params.sections, axis=0),
        np.tile(directions, (count, 1)),
        params.range_max_m,
    )
    seen[np.isinf(seen)] = np.nan
    return np.asarray(seen.reshape(count, params.sections))


def medians(points_m: Array, params: RdnmParams) -> Array:
    """Signature (sections,) in m of a scan about the robot: the median distance of each
    section's points, NaN where it holds none. Noise does not pull it towards the robot, as it
    does the nearest point's layer of :func:`rdn`."""
    out = np.full(params.sections, np.nan)
    distance = np.hypot(points_m[:, 0], points_m[:, 1])
    near = distance <= params.range_max_m
    distance = distance[near]
    position = np.arctan2(points_m[near, 1], points_m[near, 0]) * (params.sections / math.tau)
    section = np.floor(position).astype(np.int64) % params.sections
    order = np.lexsort((distance, section))
    section, distance = section[order], distance[order]
    found, first, count = np.unique(section, return_index=True, return_counts=True)
    low, high = first + (count - 1) // 2, first + count // 2
    out[found] = 0.5 * (distance[low] + distance[high])
    return out


def shift(signature: Array, r: int) -> Array:
    """Eq. 2: component ``i`` of the result is component ``i + r`` (circularly)."""
    return np.roll(signature, -r, axis=-1)


def pack(signatures: Array) -> Packed:
    """Signatures (m, sections) in whole millimetres, 0 where unknown: a quarter of the memory."""
    known = np.isfinite(signatures)
    millimetres = np.where(known, np.round(1e3 * signatures), 0.0)
    return np.clip(millimetres, known, _MOST_MM).astype(np.uint16)


def match(h_x: Array, h_y: Packed, params: RdnmParams) -> Single:
    """Cost (m, sections) in m of each candidate and each rotation; lower is better.

    ``h_x`` (sections,): the scan's signature about the robot; ``h_y`` (m, sections): the map's
    about each candidate, packed. Column ``r`` stands for the robot turned by ``r`` sections.
    Sections that the scan does not see are masked: the 90 degrees behind a scanner are no
    evidence. All inf where the scan sees nothing. (Algorithm 1, line 16, all at once.)
    """
    seen = np.flatnonzero(np.isfinite(h_x))
    if not len(seen) or not len(h_y):
        return np.full(h_y.shape, np.inf, dtype=np.float32)
    scan = h_x[seen].astype(np.float32)
    limits = np.array([params.shorter_m, params.longer_m, params.unseen_m], dtype=np.float32)
    if ENABLED:
        return kernels.match_signatures(seen, scan, h_y, *limits)
    return _match_in_numpy(seen, scan, h_y, limits)


def _match_in_numpy(seen: NDArray[np.intp], scan: Single, h_y: Packed, limits: Single) -> Single:
    sections = h_y.shape[1]
    # A robot turned by r sees in its section i what lies in the map's section i + r.
    turned = (seen[None, :] + np.arange(sections)[:, None]) % sections
    costs = np.empty(h_y.shape, dtype=np.float32)
    block = max(1, _BLOCK_ELEMENTS // turned.size)
    shorter, longer, unseen_cost = limits
    for start in range(0, len(h_y), block):
        theirs = h_y[start : start + block][:, turned]
        cost = np.abs(np.clip(scan - np.float32(1e-3) * theirs, -shorter, longer))
        costs[start : start + len(cost)] = np.where(theirs == 0, unseen_cost, cost).mean(axis=2)
    return costs


def rdnm(
    h_x: Array,
    h_y: Packed,
    candidates_m: Array,
    params: RdnmParams,
    *,
    best: int = 1,
    heading: tuple[float, float] | None = None,
) -> Array:
    """The ``best`` rough poses (k, 4), k <= best: x m, y m, theta rad, cost m; cheapest first.

    ``candidates_m`` (m, 2) with their signatures ``h_y`` (m, sections). ``heading``: (centre,
    half width) in rad limits the rotations. (Algorithm 1, procedure RDNM, lines 14-19.)
    """
    if not len(h_y):
        return np.empty((0, 4))
    costs = match(h_x, h_y, params)
    thetas = np.arange(params.sections) * (math.tau / params.sections)
    if heading is not None:
        off = np.abs(np.angle(np.exp(1j * (thetas - heading[0]))))
        # The nearest rotation always stays, however narrow the window is.
        costs = costs[:, off <= max(heading[1], off.min())]
        thetas = thetas[off <= max(heading[1], off.min())]
    keep = min(params.rotations, costs.shape[1])
    rotations = np.argpartition(costs, keep - 1, axis=1)[:, :keep]
    cost = np.take_along_axis(costs, rotations, axis=1).ravel()
    order = np.argsort(cost, kind="stable")[:best]
    order = order[np.isfinite(cost[order])]
    position = candidates_m[order // keep]
    theta = thetas[rotations.ravel()[order]]
    return np.column_stack([position, theta, cost[order]])


def as_pose(rough: Array) -> Pose2:
    """One row of :func:`rdnm` as a pose."""
    return Pose2(rough[0], rough[1], rough[2])
