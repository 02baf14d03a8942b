"""What differs between a map and the place it shows: furniture that moved, people in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array
from amr_slam.samples import Scan
from amr_slam.simulation.shapes import box, distance_to_segments, edges, odd_crossings
from amr_slam.simulation.site import Site
from amr_slam.simulation.world import World

# What is thicker than a wall and smaller than a rack can be moved.
_THICK_M = 0.28
_LONG_M = 3.3
# Inner walls touch others; things do not.
_TOUCH_M = 0.02
# Of the things that change, this share is gone; as many others have come.
_GONE_SHARE = 0.25
# A robot still passes between.
_GAP_M = 0.85


def moved_furniture(world: World, rng: np.random.Generator, share: float) -> World:
    """The world later: of its free-standing things, this share (0 to 1) has changed.

    Three quarters of these stand elsewhere, a quarter is gone and as many new ones came. Walls,
    long racks, table legs alone and what touches something else stay. A thing for which no new
    place is found is gone.
    """
    things, fixed = _things(world)
    changed = rng.permutation(len(things))[: round(share * len(things))]
    gone = round(_GONE_SHARE * len(changed))
    stays = sorted(set(range(len(things))) - {int(i) for i in changed})
    site = Site.of(fixed)
    for i in stays:
        site.put(things[i].corners_m, is_table=things[i].is_table)
    for i in changed[gone:]:
        corners = things[i].corners_m
        site.scatter(rng, corners - corners.mean(axis=0), _GAP_M, is_table=things[i].is_table)
    for _ in range(gone):
        site.scatter(rng, box(*rng.uniform([0.5, 0.4], [2.0, 1.2])), _GAP_M)
    return site.world(world.seed)


def blocked(scan: Scan, rng: np.random.Generator, share: float, sigma_m: float = 0.0) -> Scan:
    """The scan in a busy place: this share (0 to 1) of its beams ends on things that are nearer.

    Things are 0.3 to 1 m wide and 0.5 to 4 m away, round (people) or flat (pallets); each blocks
    the beams next to each other that it covers. ``sigma_m``: noise of the new ranges along the
    beam. No range becomes longer; beams without a measurement (NaN) stay so. Where too little room
    is before the walls, fewer beams are blocked.
    """
    ranges = np.array(scan.ranges_m)
    free = ~np.isnan(ranges)
    wanted = round(share * int(free.sum()))
    angles = scan.angles_rad
    left = wanted
    for _ in range(50 * (1 + len(ranges) // 10)):
        if left == 0:
            break
        middle = int(rng.integers(len(ranges)))
        width_m, part, noise = (
            rng.uniform(0.3, 1.0),
            rng.uniform(),
            rng.normal(0.0, 1.0, len(ranges)),
        )
        is_round = rng.random() < 0.5
        room_m = min(4.0, float(ranges[middle]) - 0.1)
        if not (free[middle] and room_m > 0.5):
            continue
        front_m = 0.5 + part * (room_m - 0.5)
        seen = _outline(angles - angles[middle], front_m, width_m, is_round=is_round)
        hit = np.flatnonzero(free & (seen < ranges))[:left]
        ranges[hit] = np.clip(seen[hit] + sigma_m * noise[hit], 0.01, ranges[hit])
        free[hit] = False
        left -= len(hit)
    return replace(scan, ranges_m=ranges)


def _outline(turn_rad: Array, front_m: float, width_m: float, *, is_round: bool) -> Array:
    """(n,) range in m of a thing whose front is straight ahead, +inf beside it."""
    with np.errstate(invalid="ignore"):
        if is_round:
            centre_m, radius_m = front_m + 0.5 * width_m, 0.5 * width_m
            aside_m = centre_m * np.sin(turn_rad)
            seen = centre_m * np.cos(turn_rad) - np.sqrt(radius_m**2 - aside_m**2)
            meets = np.abs(aside_m) < radius_m
        else:
            seen = front_m / np.cos(turn_rad)
            meets = np.abs(front_m * np.tan(turn_rad)) < 0.5 * width_m
    return np.where(meets & (np.abs(turn_rad) < 0.5 * math.pi), seen, np.inf)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Thing:
    corners_m: Array
    is_table: bool


def _things(world: World) -> tuple[list[_Thing], World]:
    """What can be moved, and the world without it."""
    loops, tops = _loops(world.segments_m), _loops(world.table_tops_m)
    seen_kept = np.ones(len(world.segments_m), dtype=np.bool_)
    tops_kept = np.ones(len(world.table_tops_m), dtype=np.bool_)
    things: list[_Thing] = []
    middles = np.array([world.segments_m[loop, :2].mean(axis=0) for loop in loops])
    for top in tops:
        corners = world.table_tops_m[top, :2]
        if not _is_movable(corners):
            continue
        below = [loops[i] for i in np.flatnonzero(odd_crossings(middles, edges(corners)))]
        if len(below) != len(corners):  # more than its legs
            continue
        tops_kept[top] = False
        for leg in below:
            seen_kept[leg] = False
        things.append(_Thing(corners_m=corners, is_table=True))
    for loop in loops:
        corners = world.segments_m[loop, :2]
        if not (seen_kept[loop[0]] and _is_movable(corners)):
            continue
        others = np.delete(world.segments_m, loop, axis=0)
        if len(others) and distance_to_segments(corners, others).min() > _TOUCH_M:
            seen_kept[loop] = False
            things.append(_Thing(corners_m=corners, is_table=False))
    fixed = replace(
        world,
        segments_m=world.segments_m[seen_kept],
        table_tops_m=world.table_tops_m[tops_kept],
    )
    return things, fixed


def _loops(segments: Array) -> list[NDArray[np.int64]]:
    """Rows of each closed polygon: segments in a row, each beginning where the last one ended."""
    joins = np.all(segments[1:, :2] == segments[:-1, 2:], axis=1)
    chains = np.split(np.arange(len(segments)), np.flatnonzero(~joins) + 1)
    return [
        chain
        for chain in chains
        if len(chain) >= 3 and np.array_equal(segments[chain[0], :2], segments[chain[-1], 2:])
    ]


def _is_movable(corners: Array) -> bool:
    """By the least width over all its sides, and by the distance of its furthest corners."""
    side = np.roll(corners, -1, axis=0) - corners
    normal = np.column_stack([-side[:, 1], side[:, 0]]) / np.hypot(*side.T)[:, None]
    least = float(np.ptp(corners @ normal.T, axis=0).min())
    longest = float(np.hypot(*(corners[:, None] - corners).transpose(2, 0, 1)).max())
    return least > _THICK_M and longest < _LONG_M
