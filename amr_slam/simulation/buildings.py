"""Seeded buildings of rooms along corridors: offices, and the same with all rooms alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from amr_slam.geometry import Array
from amr_slam.simulation.shapes import box, box_between
from amr_slam.simulation.site import Site
from amr_slam.simulation.world import World

# A corridor with rooms on both sides takes about this much of the building's depth.
_DEPTH_M = 13.0
# Between furniture, and from the middle of a door.
_AISLE_M = 0.95
_DOOR_FREE_M = 1.1


def offices(seed: int, area_m2: float) -> World:
    """A building of ``area_m2``: rooms with open doors of 0.95 to 1.15 m, walls of 10 to 20 cm,
    furniture."""
    rng = np.random.default_rng((seed, 2))
    plan = _Plan.draw(rng, area_m2)
    return _built(plan, rng, seed, alike=False).world(seed)


def alike_rooms(seed: int, area_m2: float, *, odd_things: int = 0) -> World:
    """A building of ``area_m2`` in which every room along a corridor has the same size, door and
    furniture: alike under a shift by one room. ``odd_things`` stand only once."""
    rng = np.random.default_rng((seed, 3))
    site = _built(_Plan.draw(rng, area_m2), rng, seed, alike=True)
    for _ in range(odd_things):
        site.scatter(rng, box(*rng.uniform(0.3, 0.8, 2)), 0.8)
    return site.world(seed)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """Measures of a building."""

    width_m: float
    height_m: float
    corridors: int
    """Along x, one above the other."""
    corridor_m: float
    """Width."""
    wall_m: float
    two_sided: bool
    """Rooms on both sides of each corridor."""

    @staticmethod
    def draw(rng: np.random.Generator, area_m2: float) -> _Plan:
        width = np.sqrt(area_m2 * rng.uniform(1.2, 2.4))
        height = area_m2 / width
        corridors = max(1, round(height / _DEPTH_M))
        return _Plan(
            width_m=width,
            height_m=height,
            corridors=corridors,
            corridor_m=rng.uniform(1.7, 2.6) if area_m2 > 80.0 else rng.uniform(1.5, 1.8),
            wall_m=rng.uniform(0.1, 0.2),
            two_sided=height / corridors > 8.5,
        )

    def spans(self, rng: np.random.Generator) -> list[tuple[float, float]]:
        """What the corridors along y that join the others leave of the width."""
        if self.corridors == 1:
            return [(0.0, self.width_m)]
        crossings = max(1, round(self.width_m / 40.0))
        places = (np.arange(crossings) + rng.uniform(0.25, 0.75, crossings)) / crossings
        lefts = places * (self.width_m - self.corridor_m)
        starts = [0.0, *(lefts + self.corridor_m)]
        return list(zip(starts, [*lefts, self.width_m], strict=True))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Room:
    corners_m: Array
    door_m: Array
    """(2,) middle of its door."""


def _built(plan: _Plan, rng: np.random.Generator, seed: int, *, alike: bool) -> Site:
    walls: list[Array] = []
    rooms: list[_Room] = []
    spans = plan.spans(rng)
    block = plan.height_m / plan.corridors
    depth = (block - plan.corridor_m) * (0.5 if plan.two_sided else 1.0)
    wall = plan.wall_m
    for number in range(plan.corridors):
        bottom, top = number * block, (number + 1) * block
        for start, end in spans:
            back = bottom
            if number:
                walls.append(box_between(start, bottom, end, bottom + wall))
                back += wall
            cuts = _cuts(start, end, plan, rng, alike=alike)
            rooms += _row(cuts, back, bottom + depth, rng, plan, walls, alike=alike)
            if plan.two_sided:
                cuts = cuts if alike else _cuts(start, end, plan, rng, alike=False)
                rooms += _row(cuts, top, top - depth, rng, plan, walls, alike=alike)
    site = Site(box_between(0.0, 0.0, plan.width_m, plan.height_m), walls)
    for room in rooms:
        if alike:  # the same draws in every room
            rng = np.random.default_rng((seed, 30))
        site.take_over(_furnished(room, rng))
    return site


def _cuts(start: float, end: float, plan: _Plan, rng: np.random.Generator, *, alike: bool) -> Array:
    """(k,) x of the left side of each partition, with those at both ends (k - 1 rooms)."""
    # Where a corridor passes, the last partition is the wall towards it.
    left = start if start > 0.0 else -plan.wall_m
    right = end - plan.wall_m if end < plan.width_m else end
    count = max(1, round((right - left) / (4.2 if alike else rng.uniform(3.5, 6.0))))
    shares = np.ones(count) if alike else rng.uniform(0.7, 1.6, count)
    places = np.concatenate([[0.0], np.cumsum(shares) / np.sum(shares)])
    cuts: Array = left + places * (right - left)
    return cuts


def _row(
    cuts: Array,
    back: float,
    front: float,
    rng: np.random.Generator,
    plan: _Plan,
    walls: list[Array],
    *,
    alike: bool,
) -> list[_Room]:
    """Rooms between partitions, from their back to the face of the corridor's wall at ``front``.

    Appends the walls to ``walls``."""
    wall = plan.wall_m
    face = front - wall if front > back else front + wall
    low, high = min(back, face), max(back, face)
    wall_low, wall_high = min(face, front), max(face, front)
    inner = cuts[(cuts >= 0.0) & (cuts + wall <= plan.width_m)]
    walls += [box_between(cut, low, cut + wall, high) for cut in inner]
    rooms: list[_Room] = []
    piece = max(0.0, float(cuts[0]))
    for left, right in zip(cuts[:-1] + wall, cuts[1:], strict=True):
        width = 1.05 if alike else rng.uniform(0.95, 1.15)
        slack = right - left - width - 0.4
        begin = left + 0.2 + slack * (0.3 if alike else rng.uniform())
        walls.append(box_between(piece, wall_low, begin, wall_high))
        piece = begin + width
        rooms.append(
            _Room(
                corners_m=box_between(left, low, right, high),
                door_m=np.array([begin + 0.5 * width, 0.5 * (face + front)]),
            )
        )
    walls.append(box_between(piece, wall_low, min(float(cuts[-1]) + wall, plan.width_m), wall_high))
    return rooms


def _furnished(room: _Room, rng: np.random.Generator) -> Site:
    """Cupboards at the walls and desks on legs: about one thing for 5 m2."""
    site = Site(room.corners_m)
    site.keep_free(room.door_m, _DOOR_FREE_M)
    area = float(np.prod(np.ptp(room.corners_m, axis=0)))
    for _ in range(round(area / 9.0 * rng.uniform(0.6, 1.4))):
        site.at_wall(rng, room.corners_m, rng.uniform([0.6, 0.35], [1.8, 0.6]), _AISLE_M)
    for _ in range(round(area / 12.0 * rng.uniform(0.4, 1.4))):
        desk = box(*rng.uniform([1.2, 0.7], [1.6, 0.8]))
        site.scatter(rng, desk, _AISLE_M, is_table=True)
    return site
