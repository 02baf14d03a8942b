"""Watches how the place departs from its map; never touches the map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.living.change import ChangedCells, Kind, MapDiff, things_of
from amr_slam.living.evidence import Evidence
from amr_slam.living.params import WatchParams
from amr_slam.living.seeing import Sight, look
from amr_slam.map import PointMap
from amr_slam.map.grid import Keys
from amr_slam.map.rays import Rays, pack
from amr_slam.registration import fit

_MOST_SIGMA_M: Final = 0.08
_MOST_SIGMA_RAD: Final = 0.012
"""A scan whose pose is known worse than this says nothing of single cells."""
_RAYS_PER_CELL: Final = 12
_MOST_RAYS: Final = 20_000
"""Of what is new, 220 kB are kept: what it can be accepted with."""
_TIDY_EVERY: Final = 64
_COUNT_EVERY: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """The part of a scan that ended on what is new."""

    stamp_ns: int
    """UTC."""
    map_from_base: Pose2
    sigma_m: float
    """Noise of the scan's ranges."""
    rays: Rays


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeCounts:
    """How much has changed, as of the newest scans."""

    new: int
    gone: int
    oldest_since_s: float | None
    """UTC seconds when the oldest of them was first seen; None without any."""


class Watcher:
    """Evidence of one map's changes: votes of scans in, a list of things out."""

    def __init__(self, known: PointMap, params: WatchParams) -> None:
        self._known = known
        self._params = params
        self.new = Evidence(params)
        self.gone = Evidence(params)
        self.sightings: list[Sighting] = []
        self.scans = 0
        """That were heard: what is derived from the evidence is valid for one number."""
        self._counted: tuple[int, ChangeCounts] | None = None

    def see(self, cloud: Cloud, pose: Pose2, covariance: Array, utc_ns: int) -> None:
        """A scan that was accepted at ``pose`` (map_from_base, ``covariance`` (3, 3))."""
        target = self._known.surfaces()
        if not len(cloud) or not len(target) or _vague(covariance):
            return
        space = self._known.space
        sight = look(cloud, target, space, pose, self._params.range_m)
        self.new.note(sight.ends, np.setdiff1d(sight.passed, sight.ends), utc_ns)
        self.gone.note(np.setdiff1d(sight.walls_passed, sight.walls_met), sight.walls_met, utc_ns)
        self._remember(cloud, pose, sight, utc_ns)
        self.scans += 1
        if self.scans % _TIDY_EVERY == 0:
            self.tidy(utc_ns)

    def diff(self) -> MapDiff:
        """All things that enough passes have shown."""
        cells = (self._cells("new", self.new), self._cells("gone", self.gone))
        return MapDiff(
            changes=things_of(cells, self._known.space.cell_m), against="what was watched"
        )

    def counts(self) -> ChangeCounts:
        """Of :meth:`diff`, some scans old."""
        if self._counted is None or self.scans - self._counted[0] >= _COUNT_EVERY:
            diff = self.diff()
            since = [one.since_s for one in diff.changes if one.since_s is not None]
            counts = ChangeCounts(
                new=len(diff.of("new")),
                gone=len(diff.of("gone")),
                oldest_since_s=min(since, default=None),
            )
            self._counted = self.scans, counts
        return self._counted[1]

    def tidy(self, utc_ns: int) -> None:
        """Forget what passes have cleared, and rays that nobody will ask for."""
        self.new.tidy(utc_ns)
        self.gone.tidy(utc_ns)
        self._forget_rays(_RAYS_PER_CELL)
        if sum(len(one.rays) for one in self.sightings) > _MOST_RAYS:
            self._forget_rays(_RAYS_PER_CELL // 4)
        while sum(len(one.rays) for one in self.sightings) > _MOST_RAYS:
            del self.sightings[0]

    def rebase(self, known: PointMap) -> None:
        """The same evidence against another version of the map, in the same frame and with the same
        cells: what that version shows itself is no change any more."""
        target, space = known.surfaces(), known.space
        self._known, self._counted = known, None
        centres = space.centres(self.new.rows["key"])
        far = fit.distances(target, centres) > 0.25 + 3.0 * known.across_m
        self.new.keep(self.new.rows["key"][far & target.lookup.seen_free(centres)])
        self.gone.keep(np.unique(space.keys_of(target.points_m)))
        self._forget_rays(_RAYS_PER_CELL)

    def rays_in(self, keys: Keys) -> list[Sighting]:
        """The parts of the sightings that ended in these cells, the oldest first."""
        parts = [
            replace(one, rays=one.rays.take(np.isin(self._cell_keys(one), keys)))
            for one in self.sightings
        ]
        return [part for part in parts if len(part.rays)]

    def _cells(self, kind: Kind, evidence: Evidence) -> ChangedCells:
        rows = evidence.shown()
        rows = rows[rows["passes"] >= self._params.passes]
        return ChangedCells(
            kind=kind,
            centres_m=self._known.space.centres(rows["key"]),
            passes=rows["passes"],
            since_ns=rows["since_ns"],
            seen_ns=rows["seen_ns"],
        )

    def _remember(self, cloud: Cloud, pose: Pose2, sight: Sight, utc_ns: int) -> None:
        if len(sight.rows):
            rays = pack(cloud.take(sight.rows))
            self.sightings.append(
                Sighting(stamp_ns=utc_ns, map_from_base=pose, sigma_m=cloud.sigma_m, rays=rays)
            )

    def _cell_keys(self, sighting: Sighting) -> Keys:
        return self._known.space.keys_of(sighting.map_from_base @ sighting.rays.ends_m)

    def _forget_rays(self, per_cell: int) -> None:
        """Keep those that ended in cells which may have changed, the newest ones of each cell."""
        if not self.sightings:
            return
        keys = np.concatenate([self._cell_keys(one) for one in self.sightings])
        backwards = keys[::-1]
        order = np.argsort(backwards, kind="stable")
        first = np.searchsorted(backwards[order], backwards[order])
        age = np.empty(len(keys), dtype=np.intp)
        age[order] = np.arange(len(keys)) - first
        kept = (age < per_cell)[::-1] & np.isin(keys, self.new.rows["key"])
        ends = np.cumsum([len(one.rays) for one in self.sightings])
        parts = [
            replace(one, rays=one.rays.take(part))
            for one, part in zip(self.sightings, np.split(kept, ends[:-1]), strict=True)
        ]
        self.sightings = [part for part in parts if len(part.rays)]


def _vague(covariance: Array) -> bool:
    worst_m2 = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
    return worst_m2 > _MOST_SIGMA_M**2 or float(covariance[2, 2]) > _MOST_SIGMA_RAD**2
