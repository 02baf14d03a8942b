"""What the map has seen, how often, and where the seen floor ends without a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from amr_slam.commissioning.places import components
from amr_slam.geometry import Array
from amr_slam.map import PointMap

# A border this near to a wall is the wall's own: rays count as free up to a margin before it.
_WALL_M = 0.4
# Below a robot that stood and scanned, nothing is seen either.
_STOOD_M = 0.5
# Shorter ones are gaps between the beams.
_LEAST_BORDER_M = 0.8
# A border is worth a drive where the robot comes this near.
_NEAR_M = 3.0
_MOST_BORDERS = 9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Border:
    """The seen floor ends here, and no wall ends it."""

    middle_m: Array
    """(2,) the border's cell that is nearest to its middle."""
    length_m: float
    cells_m: Array
    """(n, 2) centres of its cells."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """What has been seen."""

    floor_m2: float
    """Seen free."""
    drivable_m2: float
    """Of it, where the robot fits and gets to, by the grid of places."""
    walls_m: float
    """Length of all walls, by the number of their points."""
    cells_m: Array
    """(n, 2) centres of the cells of the floor."""
    cell_m: float
    seen: Array
    """(n,) how many scans passed over each."""
    counted: bool
    """Whether the map tells how often: one made by another program does not."""
    seldom: float
    """Share of the floor that fewer scans than ``seen_often`` passed over."""
    borders: tuple[Border, ...]
    """Within the robot's reach, longest first."""
    scans: int
    scans_with_rays: int

    @property
    def borders_m(self) -> float:
        return sum(border.length_m for border in self.borders)


def coverage(known: PointMap, places: Array, grid_m: float, seen_often: int) -> Coverage:
    """``places`` (n, 2): where the robot may stand, ``grid_m`` apart."""
    space = known.space
    free = space.sums[:, 0] > space.sums[:, 1]
    cells, seen = space.centres()[free], space.sums[free, 0].astype(np.float64)
    target = known.target()
    counted = bool(len(seen)) and float(seen.max()) > 1.0
    return Coverage(
        floor_m2=known.area_m2(),
        drivable_m2=len(places) * grid_m**2,
        walls_m=len(target) * target.spacing_m,
        cells_m=cells,
        cell_m=space.cell_m,
        seen=seen,
        counted=counted,
        seldom=float(np.mean(seen < seen_often)) if counted else 0.0,
        borders=_borders(known, cells, places),
        scans=len(known.path),
        scans_with_rays=sum(len(rays) > 0 for rays in known.rays),
    )


def _borders(known: PointMap, cells: Array, places: Array) -> tuple[Border, ...]:
    if not len(cells) or not len(places):
        return ()
    space = known.space
    steps = space.cell_m * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    beside = [space.find(space.keys_of(cells + step)) < 0 for step in steps]
    edge = cells[np.any(beside, axis=0)]
    driven = np.array([pose.translation for _, pose in known.path]).reshape(-1, 2)
    for others, within_m, keep_near in (
        (driven, _STOOD_M, False),
        (known.target().points_m, _WALL_M, False),
        (places, _NEAR_M, True),
    ):
        if len(edge) and len(others):
            distance = cKDTree(others).query(edge, distance_upper_bound=within_m)[0]
            edge = edge[np.isfinite(distance) == keep_near]
    if not len(edge):
        return ()
    groups = components(edge, 2.5 * space.cell_m)
    found = []
    for group in range(int(groups.max()) + 1):
        mine = edge[groups == group]
        # Along a slanting line, a staircase has about that many cells as it is long.
        length_m = len(mine) * space.cell_m
        if length_m >= _LEAST_BORDER_M:
            nearest = int(np.argmin(np.hypot(*(mine - mine.mean(axis=0)).T)))
            found.append(Border(middle_m=mine[nearest], length_m=length_m, cells_m=mine))
    found.sort(key=lambda border: -border.length_m)
    return tuple(found[:_MOST_BORDERS])
