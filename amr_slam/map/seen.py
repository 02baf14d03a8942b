"""What a map has been told, and what it answers: walls, free floor, places, signatures."""

from __future__ import annotations

import abc
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2
from amr_slam.map import effective
from amr_slam.map.deconvolution import Deconvolution
from amr_slam.map.grid import SparseGrid
from amr_slam.map.layers import LayerKind, Layers
from amr_slam.map.params import MapParams
from amr_slam.map.provenance import Imported, Merged, Reframing
from amr_slam.map.rays import Rays
from amr_slam.map.ties import no_ties
from amr_slam.registration import field, rdnm
from amr_slam.registration.alignment import Target
from amr_slam.registration.field import Field, FieldParams
from amr_slam.registration.rdnm import Packed, RdnmParams

# Sums over a cell's points: weight; by weight x, y, cos 2phi, sin 2phi of the normal, sight x, y;
# number.
CHANNELS = 8
_SIGHT_M = 25.0


class SeenMap(abc.ABC):
    """All that is in a map, and the answers to what is asked of it, each found once a revision.

    Walls are sums per cell: a normal is summed as its double angle, so that a thin board seen
    from both sides keeps its direction, and points to where it was seen from. Free space is
    counted once per scan and cell. How they come to be there is not seen here.
    """

    def __init__(self, params: MapParams, name: str = "map") -> None:
        self.params = params
        self.name = name
        self._walls = SparseGrid(params.cell_m, CHANNELS)
        # Scans that passed, scans that ended.
        self._space = SparseGrid(params.free_cell_m, 2, counts=True)
        self.path: list[tuple[int, Pose2]] = []
        """(stamp ns, map_from_base) of each scan that the map is made of."""
        self.noises_m: list[float] = []
        """Noise of each of these scans."""
        self.rays: list[Rays] = []
        """What each of these scans saw; nothing where it was forgotten for the memory's sake."""
        self.reframings: tuple[Reframing, ...] = ()
        """How its frame became what it is, oldest first; none where a run's start is the origin."""
        self.merged: tuple[Merged, ...] = ()
        """Other maps whose scans are in it, in the order in which they joined."""
        self.imported: Imported | None = None
        """The picture that it began as, if another program made it."""
        self.layers = Layers()
        """What people have drawn over it. Changed by :meth:`edit` only."""
        self.ties = no_ties()
        """The pose graph of the path's scans, as far as one is known."""
        self.revision = 0
        """+1 with each insertion and edit: what is derived from the map holds for one revision."""
        self._deconvolution: Deconvolution | None = None
        self._changed: tuple[Array, Array] | None = None  # corners of what it does not know yet
        self._latest: tuple[int, Target] | None = None
        self._whole: tuple[int, Target] | None = None
        self._landmarks: tuple[int, Target] | None = None
        self._places: dict[tuple[float, float], tuple[int, Array]] = {}
        self._signatures: tuple[int, RdnmParams, Array, Packed] | None = None
        self._field: tuple[int, FieldParams, Field] | None = None

    @abc.abstractmethod
    def _draw_appended(self) -> None:
        """Bring walls and space up to what has joined the map."""

    def __len__(self) -> int:
        return len(self.walls)

    @property
    def walls(self) -> SparseGrid:
        """Sums over the points of each cell, of all scans."""
        self._draw_appended()
        return self._walls

    @property
    def space(self) -> SparseGrid:
        """How many scans passed each cell, and how many ended in it."""
        self._draw_appended()
        return self._space

    @property
    def sigma_m(self) -> float:
        """Noise of the scans that the map is made of: their median, as clutter looks like noise."""
        return float(np.median(self.noises_m)) if self.noises_m else 0.0

    @property
    def across_m(self) -> float:
        """Noise of these scans' points across the walls: their median too."""
        return float(np.median([rays.across_m for rays in self.rays])) if self.rays else 0.0

    @property
    def error_m(self) -> float:
        """How far its walls may lie from where it has them, all together: no scan tells that."""
        return 0.0 if self.imported is None else self.imported.error_m

    @property
    def spacing_m(self) -> float:
        """Distance of neighbouring points along a wall."""
        return self.params.cell_m if self.imported is None else self.imported.resolution_m

    def surfaces(self) -> Target:
        """All walls, those in zones where nothing is a landmark included: the map for people."""
        return self._whole_target()

    def target(self, centre: Pose2 | None = None, radius_m: float = _SIGHT_M) -> Target:
        """The wall points (all, or within ``radius_m`` of a pose) to register against.

        All of them come settled; near a pose, the walls of noisy scans are as good as the last
        scan left them, so that each scan costs little.
        """
        zones = self.layers.areas(LayerKind.ZONE)
        if centre is not None:
            near = self._near_target(centre, radius_m)
            return effective.landmarks(near, zones) if zones else near
        if not zones:
            return self._whole_target()
        if self._landmarks is None or self._landmarks[0] != self.revision:
            self._landmarks = self.revision, effective.landmarks(self._whole_target(), zones)
        return self._landmarks[1]

    def _near_target(self, centre: Pose2, radius_m: float) -> Target:
        if self._thins():
            latest = self._latest_target()
            near = _near(latest.points_m, centre, radius_m)
            free = latest.free_m[_near(latest.free_m, centre, radius_m)]
            points_m, normals = latest.points_m[near], latest.normals[near]
            return replace(latest, points_m=points_m, normals=normals, free_m=free)
        near = _near(self.walls.centres(), centre, radius_m)
        free_m = self._free_cells()
        found = self._in_space(
            self._plain(np.flatnonzero(near)), free_m[_near(free_m, centre, radius_m)]
        )
        if not self.layers:
            return found
        near = _near(found.points_m, centre, radius_m)  # walls are drawn anywhere
        return replace(found, points_m=found.points_m[near], normals=found.normals[near])

    def _thins(self) -> bool:
        """Whether walls are lines found in bands (noisy scans), or the cells' mean points."""
        return self.params.thin and self.sigma_m > self.params.noisy_m

    def _whole_target(self, *, growing: bool = False) -> Target:
        if self._whole is None or self._whole[0] != self.revision:
            everything = np.arange(len(self.walls))
            walls = self._settled(growing=growing) if self._thins() else self._plain(everything)
            self._whole = (self.revision, self._in_space(walls, self._free_cells()))
        return self._whole[1]

    def _latest_target(self, *, growing: bool = True) -> Target:
        """All walls, at the cost of one scan where :meth:`_whole_target` settles them anew."""
        for known in (self._whole, self._latest):
            if known is not None and known[0] == self.revision:
                return known[1]
        if self._deconvolution is None or not self._thins():
            return self._whole_target(growing=growing)
        if self._changed is not None and self._deconvolution.fits(self.walls, self.across_m):
            ridges = self._deconvolution.follow(self.walls, self.across_m, *self._changed)
            self._changed = None
            self._latest = (self.revision, self._in_space(self._lines(ridges), self._free_cells()))
            return self._latest[1]
        return self._whole_target(growing=growing)

    def _settled(self, *, growing: bool) -> Target:
        """The thin walls; ``growing``: what follows them with the next scan is kept too, which a
        map that is only localized in has no use for."""
        deconvolution = Deconvolution(self.params.cell_m)
        if not deconvolution.fits(self.walls, self.across_m):
            return self._plain(np.arange(len(self.walls)))
        ridges = deconvolution.settle(self.walls, self.across_m)
        self._deconvolution, self._changed = deconvolution if growing else None, None
        return self._lines(ridges)

    def _lines(self, ridges: Array) -> Target:
        here = ~self._vanished(ridges[:, :2])
        return Target(points_m=ridges[here, :2], normals=ridges[here, 2:], spacing_m=self.spacing_m)

    def _free_cells(self) -> Array:
        """Centres (k, 2) of the cells that more rays passed than ended in."""
        return self.space.centres()[self.space.sums[:, 0] > self.space.sums[:, 1]]

    def _in_space(self, walls: Target, free_m: Array) -> Target:
        there = replace(walls, sigma_m=self.sigma_m, free_m=free_m, cell_m=self.space.cell_m)
        return effective.edited(there, self.layers) if self.layers else there

    def _plain(self, rows: NDArray[np.intp]) -> Target:
        """The mean points of these wall cells."""
        sums = self.walls.sums[rows]
        count = np.maximum(sums[:, 0:1], 1e-9)
        points = sums[:, 1:3] / count
        here = ~self._vanished(points)
        sums, count, points = sums[here], count[here], points[here]
        direction = 0.5 * np.arctan2(sums[:, 4], sums[:, 3])
        # Cells in which the directions disagree (corners, clutter) have no normal.
        agreed = np.hypot(sums[:, 3], sums[:, 4]) > 0.4 * count[:, 0]
        normals = np.stack([np.cos(direction), np.sin(direction)], axis=1)
        normals = np.where(np.sum(normals * sums[:, 5:7], axis=1)[:, None] < 0.0, -normals, normals)
        return Target(
            points_m=points,
            normals=np.where(agreed[:, None], normals, 0.0),
            spacing_m=self.spacing_m,
        )

    def _vanished(self, points: Array) -> NDArray[np.bool_]:
        """Which wall points (n, 2) later scans looked through: people, opened doors."""
        cell = self.space.find(self.space.keys_of(points))
        passed = np.where(cell >= 0, self.space.sums[cell, 0], 0.0)
        ended = np.where(cell >= 0, self.space.sums[cell, 1], 0.0)
        return np.asarray(passed > self.params.vanish_ratio * np.maximum(ended, 1.0))

    def places(self, spacing_m: float, robot_radius_m: float) -> Array:
        """Grid points (m, 2) every ``spacing_m`` on seen-free cells where the robot fits.

        Algorithm 2, line 3, with "points removed where the AMR would not fit".
        """
        cached = self._places.get((spacing_m, robot_radius_m))
        if cached is None or cached[0] != self.revision:
            cached = self.revision, self._find_places(spacing_m, robot_radius_m)
            self._places[spacing_m, robot_radius_m] = cached
        return cached[1]

    def _find_places(self, spacing_m: float, robot_radius_m: float) -> Array:
        cells = self._free_cells()
        if not len(cells):
            return np.empty((0, 2))
        grid = SparseGrid(spacing_m, 1)
        grid.add(grid.keys_of(cells), np.ones((len(cells), 1)))
        # A grid cell counts where a fair part of its area was seen free.
        enough = 0.3 * (spacing_m / self.space.cell_m) ** 2
        centres = grid.centres()[grid.sums[:, 0] >= enough]
        walls = self._latest_target(growing=False)
        if len(walls):
            clearance = np.asarray(
                walls.tree.query(centres, distance_upper_bound=robot_radius_m)[0]
            )
            centres = centres[~np.isfinite(clearance)]
        return np.asarray(centres)

    def signatures(
        self, spacing_m: float, robot_radius_m: float, params: RdnmParams
    ) -> tuple[Array, Packed]:
        """(places (m, 2), their packed RDN signatures (m, sections)), once per revision."""
        places = self.places(spacing_m, robot_radius_m)
        cached = self._signatures
        if cached is None or cached[:2] != (self.revision, params) or cached[2] is not places:
            walls = self.target()
            h = rdnm.of_map(walls, places, params)
            cached = self._signatures = (self.revision, params, places, h)
        return cached[2], cached[3]

    def field(self, params: FieldParams) -> Field:
        """The walls' likelihood field, computed once per revision."""
        cached = self._field
        if cached is None or cached[:2] != (self.revision, params):
            built = field.build(self.target(), params)
            cached = self._field = (self.revision, params, built)
        return cached[2]

    def area_m2(self) -> float:
        """Floor area that was seen free."""
        return len(self._free_cells()) * self.space.cell_m**2

    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) of the walls in m; zeros for an empty map."""
        drawn = [one.corners_m for one in self.layers.active if one.kind is LayerKind.WALL]
        centres = np.concatenate([self.walls.centres(), *drawn])
        if not len(centres):
            return 0.0, 0.0, 0.0, 0.0
        low, high = centres.min(axis=0), centres.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _near(points: Array | NDArray[np.float32], centre: Pose2, radius_m: float) -> NDArray[np.bool_]:
    distance = np.hypot(points[:, 0] - centre.x_m, points[:, 1] - centre.y_m)
    return np.asarray(distance <= min(radius_m, math.inf))
