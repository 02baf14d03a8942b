"""Changes taken into a map: a new version of it, the old one untouched.

A map is what its scans' rays say. Rays that a change has made untrue are cut: those that ended on
what is gone are dropped, those that went where something new stands begin behind it. What is new
joins by the parts of the scans that saw it, so that a map rebuilt from its rays is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2
from amr_slam.living.change import MapChange, MapDiff
from amr_slam.living.params import AcceptPolicy
from amr_slam.living.watcher import Sighting, Watcher
from amr_slam.map import PointMap
from amr_slam.map.grid import Keys, SparseGrid
from amr_slam.map.rays import Rays

_CRUMB_CELLS: Final = 4
"""What is left of a wall around what is gone goes with it, up to so many cells."""
_STEP_M: Final = 0.05
_LEAST_RAY_M: Final = 0.2
_MOST_SCANS: Final = 12
"""Parts of scans by which one change joins."""
_LEAST_RAYS: Final = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accepted:
    """A new version of a map."""

    map: PointMap
    taken: tuple[MapChange, ...]
    """What it has of the changes that were to be accepted."""
    left: tuple[MapChange, ...]
    """New things of which too few rays are kept: to be seen once more first."""


def eligible(diff: MapDiff, policy: AcceptPolicy) -> tuple[MapChange, ...]:
    """What the policy accepts without a person."""
    if not policy.passes:
        return ()
    return tuple(change for change in diff.changes if _fits(change, policy))


def _fits(change: MapChange, policy: AcceptPolicy) -> bool:
    since_s, seen_s, passes = change.since_s, change.seen_s, change.passes
    if since_s is None or seen_s is None or passes is None:
        return False
    return (
        passes >= policy.passes
        and seen_s - since_s >= 3600.0 * policy.age_h
        and change.area_m2 <= policy.area_m2
    )


def accept(known: PointMap, watcher: Watcher, chosen: Sequence[MapChange]) -> Accepted:
    """A new map with the chosen changes of ``watcher.diff()`` in it."""
    fresh = known.copied()
    space = fresh.space
    seen = {
        change.number: watcher.rays_in(_widened(space, change.cells_m))
        for change in chosen
        if change.kind == "new"
    }
    left = tuple(
        change
        for change in chosen
        if change.kind == "new" and sum(len(s.rays) for s in seen[change.number]) < _LEAST_RAYS
    )
    taken = tuple(change for change in chosen if change not in left)
    for change in (one for one in taken if one.kind == "gone"):
        clear(fresh, change)
    for change in (one for one in taken if one.kind == "new"):
        _put(fresh, change, seen[change.number])
    fresh.revision += 1
    return Accepted(map=fresh, taken=taken, left=left)


def _widened(space: SparseGrid, cells_m: Array) -> Keys:
    """These cells and the eight around each."""
    side = space.cell_m * np.array([-1.0, 0.0, 1.0])
    around = np.stack(np.meshgrid(side, side), axis=-1).reshape(1, -1, 2)
    return np.unique(space.keys_of((cells_m[:, None, :] + around).reshape(-1, 2)))


# -- what is gone


def clear(fresh: PointMap, change: MapChange) -> None:
    """Take what is gone out of a map: its wall, and the rays that ended on it."""
    space, walls = fresh.space, fresh.walls
    wall_cells = space.keys_of(walls.sums[:, 1:3].astype(np.float64) / walls.sums[:, :1])
    gone = _with_crumbs(space, np.unique(wall_cells), space.keys_of(change.cells_m))
    away = np.isin(wall_cells, gone)
    walls.keys, walls.sums = walls.keys[~away], walls.sums[~away]
    _drop_ends(fresh, gone)
    # Beams have gone through on all sides: there is nothing inside any more either.
    inside = _inside(space, space.centres(gone))
    unknown = inside[space.find(inside) < 0]
    space.add(unknown, np.tile([1.0, 0.0], (len(unknown), 1)))
    rows = space.find(np.union1d(gone, inside))
    rows = rows[rows >= 0]
    space.sums[rows, 0] = np.maximum(space.sums[rows, 0], 1.0)
    space.sums[rows, 1] = 0.0


def _with_crumbs(space: SparseGrid, wall_cells: Keys, core: Keys) -> Keys:
    """The core, and the small pieces of wall that would be left around it."""
    rest = np.setdiff1d(wall_cells, core)
    if not len(rest):
        return core
    centres = space.centres(rest)
    near = 1.6 * space.cell_m
    pairs = scipy.spatial.cKDTree(centres).query_pairs(near, output_type="ndarray")
    links = scipy.sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(rest), len(rest)))
    groups = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    touching = np.isfinite(
        scipy.spatial.cKDTree(space.centres(core)).query(centres, distance_upper_bound=near)[0]
    )
    small = np.bincount(groups)[groups] <= _CRUMB_CELLS
    crumbs = np.isin(groups, groups[touching & small])
    return np.union1d(core, rest[crumbs])


def _inside(space: SparseGrid, centres: Array) -> Keys:
    """Cells within the hull of these."""
    try:
        hull = scipy.spatial.ConvexHull(centres)
    except (scipy.spatial.QhullError, ValueError):  # a line has no inside
        return np.empty(0, dtype=np.int64)
    low, high = centres.min(axis=0), centres.max(axis=0)
    steps = np.round((high - low) / space.cell_m).astype(np.int64) + 1
    grid = low + space.cell_m * np.argwhere(np.ones(steps, dtype=np.bool_))
    deep = np.all(grid @ hull.equations[:, :2].T + hull.equations[:, 2] <= 1e-6, axis=1)
    return np.unique(space.keys_of(grid[deep]))


def _drop_ends(fresh: PointMap, cells: Keys) -> None:
    for row, ((_, pose), rays) in enumerate(zip(fresh.path, fresh.rays, strict=True)):
        if len(rays):
            ends = fresh.space.keys_of(pose @ rays.ends_m)
            fresh.rays[row] = rays.take(~np.isin(ends, cells))


# -- what is new


def _put(fresh: PointMap, change: MapChange, seen: Sequence[Sighting]) -> None:
    make_room(fresh, change)
    every = max(1, -(-len(seen) // _MOST_SCANS))
    for part in seen[::-1][::every][::-1]:
        fresh.insert(part.rays.cloud(part.stamp_ns, part.sigma_m), part.map_from_base)


def make_room(fresh: PointMap, change: MapChange) -> None:
    """Take back that a map has seen floor where something new stands, for what shows it to join."""
    space = fresh.space
    stands = space.keys_of(change.cells_m)
    for row, ((_, pose), rays) in enumerate(zip(fresh.path, fresh.rays, strict=True)):
        if len(rays):
            fresh.rays[row] = _cut(space, pose, rays, change, stands)
    rows = space.find(stands)
    space.sums[rows[rows >= 0], 0] = 0.0


def _cut(space: SparseGrid, pose: Pose2, rays: Rays, change: MapChange, stands: Keys) -> Rays:
    """The rays that went through where something stands now begin behind it."""
    ends, origins = pose @ rays.ends_m, pose @ rays.origins_m
    beams = ends - origins
    reach = np.hypot(*beams.T)
    along = beams / np.maximum(reach, 1e-9)[:, None]
    through = np.flatnonzero(_passes_box(origins, along, reach, change))
    if not len(through):
        return rays
    steps = np.arange(0.0, float(reach[through].max()), _STEP_M)
    places = origins[through][:, None, :] + steps[:, None] * along[through][:, None, :]
    inside = np.isin(space.keys_of(places.reshape(-1, 2)), stands).reshape(places.shape[:2])
    inside &= steps < reach[through][:, None]
    last = np.where(inside, steps, -1.0).max(axis=1)
    met = last >= 0.0
    rows, behind_m = through[met], last[met] + 1.5 * space.cell_m
    fresh = (origins[rows] + behind_m[:, None] * along[rows]) - pose.translation
    moved = rays.origins.copy()
    moved[rows] = np.round((fresh @ pose.rotation) / rays.quantum_m).astype(np.int16)
    kept = np.ones(len(rays), dtype=np.bool_)
    kept[rows] = reach[rows] - behind_m >= _LEAST_RAY_M
    return replace(rays, origins=moved).take(kept)


def _passes_box(origins: Array, along: Array, reach: Array, change: MapChange) -> NDArray[np.bool_]:
    """Rays that come near the box of a change: a circle around it is enough."""
    x_min, y_min, x_max, y_max = change.box_m
    to_centre = np.array(change.centre_m) - origins
    at = np.clip(np.sum(to_centre * along, axis=1), 0.0, reach)
    off = np.hypot(*(to_centre - at[:, None] * along).T)
    return np.asarray(off <= 0.5 * np.hypot(x_max - x_min, y_max - y_min))
