"""Recordings of real robots, cut so that the map and the scans to be found are of different passes.

The published reference says where each scan was taken: maps are made there, and answers judged.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.recording import Log, Sample, Trajectory, read_log, read_tum
from amr_slam.samples import Scan

PARTS: Final = 2
"""A recording is cut into this many parts of equal way; each is sought in a map of the others. Two:
one pass maps, the other is sought. More parts cover more scans and cost a map each."""
APART_S: Final = 60.0
"""A mapping scan is at least this long before or after the whole part that is sought in its map,"""
APART_M: Final = 10.0
"""and this much of the way: a robot that stands still is on no other pass a minute later."""
COVERED: Final = 0.85
"""A pose is covered if at least this share of its scan's points lies on mapped walls."""
MAPPED_M: Final = 0.2
"""A point this near to a point of a mapping scan lies on a mapped wall. Mapping beams, 1 degree
apart, end up to 0.17 m apart on a wall that is met squarely at 10 m."""

KINDS: Final = {
    "intel": "offices",
    "mit_csail": "offices",
    "fhw": "halls",
    "acapulco": "halls",
    "seattle": "corridors",
    "mit_killian": "corridors",
}
"""By the look of the maps at the reference poses: rooms with furniture along short corridors; open
floors with stands and pillars; corridors only, where most scans see two walls and some doors."""

# Visits nearer than both to the one before add nothing.
_STEP_M = 0.25
_STEP_RAD = 0.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Visit:
    """A scan and where it was taken."""

    cloud: Cloud
    """In the base frame, which in these recordings is the scanner's."""
    pose: Pose2
    """map_from_base by the reference."""

    @property
    def stamp_ns(self) -> int:
        return self.cloud.stamp_ns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """One log and its reference."""

    name: str
    visits: tuple[Visit, ...]
    """In the order of time, 0.25 m or 0.25 rad apart."""
    samples: tuple[Sample, ...]
    """All wheels, and all scans whose pose the reference gives."""
    reference: Trajectory

    @property
    def kind(self) -> str:
        """Of environment."""
        return KINDS.get(self.name, "not classified")

    @staticmethod
    def of(name: str, log: Log, reference: Trajectory, params: CloudParams) -> Recording:
        """Scans count at the very stamps of the reference: nothing is interpolated."""
        poses = {int(t): reference.pose(k) for k, t in enumerate(reference.stamps_ns)}
        samples = tuple(s for s in log.samples if not isinstance(s, Scan) or s.stamp_ns in poses)
        visits: list[Visit] = []
        for scan in samples:
            if not isinstance(scan, Scan):
                continue
            pose = poses[scan.stamp_ns]
            if visits and not _moved(visits[-1].pose, pose):
                continue
            cloud = cloud_from_scan(scan, Pose2.identity(), params)
            if len(cloud):
                visits.append(Visit(cloud=cloud, pose=pose))
        return Recording(name=name, visits=tuple(visits), samples=samples, reference=reference)


def recordings(folder: Path) -> list[str]:
    """Names of the logs in ``folder`` that have a reference (``NAME.corrected.tum``)."""
    names = sorted(path.name.removesuffix(".corrected.tum") for path in folder.glob("*.tum"))
    return [name for name in names if (folder / f"{name}.log.gz").exists()]


def read_recording(folder: Path, name: str, params: CloudParams) -> Recording:
    """``NAME.log.gz`` and ``NAME.corrected.tum``. Raises RecordingError where damaged."""
    log = read_log(folder / f"{name}.log.gz")
    return Recording.of(name, log, read_tum(folder / f"{name}.corrected.tum"), params)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pass:
    """A part of a recording that is sought, and the scans of other passes that map for it."""

    asked: tuple[Visit, ...]
    mapping: tuple[Visit, ...]
    covered: Array
    """(len(asked),) share of each asked scan's points that lies on mapped walls."""

    @property
    def end_ns(self) -> int:
        return self.asked[-1].stamp_ns

    def map(self, params: SlamParams) -> PointMap:
        """Of the mapping scans at their reference poses."""
        known = PointMap(params.map)
        for visit in self.mapping:
            known.insert(visit.cloud, visit.pose)
        return known


def passes(visits: Sequence[Visit], parts: int = PARTS) -> list[Pass]:
    """The recording's parts, each with the scans that map for it; parts without any are left
    out."""
    found: list[Pass] = []
    for asked, mapping in cut(visits, parts):
        if len(asked) and len(mapping):
            seen = cKDTree(np.concatenate([visits[k].pose @ visits[k].cloud.points_m
                                           for k in mapping]))  # fmt: skip
            found.append(
                Pass(
                    asked=tuple(visits[k] for k in asked),
                    mapping=tuple(visits[k] for k in mapping),
                    covered=np.array([coverage(visits[k], seen) for k in asked]),
                )
            )
    return found


def cut(visits: Sequence[Visit], parts: int) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """For each of ``parts`` parts of equal way: its rows, and the rows of the visits that are
    APART_S and APART_M before its first or after its last one."""
    stamps_s = 1e-9 * np.array([visit.stamp_ns - visits[0].stamp_ns for visit in visits])
    steps_m = [a.pose.distance_to(b.pose) for a, b in itertools.pairwise(visits)]
    way_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    part = np.minimum(parts * way_m / max(way_m[-1], 1e-9), parts - 1).astype(np.intp)
    rows: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
    for k in range(parts):
        asked = np.flatnonzero(part == k)
        if not len(asked):
            continue
        first, last = asked[0], asked[-1]
        before = (stamps_s <= stamps_s[first] - APART_S) & (way_m <= way_m[first] - APART_M)
        after = (stamps_s >= stamps_s[last] + APART_S) & (way_m >= way_m[last] + APART_M)
        rows.append((asked, np.flatnonzero(before | after)))
    return rows


def coverage(visit: Visit, seen: cKDTree) -> float:
    """Share of the scan's points within MAPPED_M of the points in ``seen`` when placed at its
    reference pose. The raw points of the mapping scans are asked, not the product's map: what the
    map loses must not excuse the localization."""
    distance, _ = seen.query(visit.pose @ visit.cloud.points_m, distance_upper_bound=MAPPED_M)
    return float(np.mean(np.isfinite(distance)))


def _moved(a: Pose2, b: Pose2) -> bool:
    return a.distance_to(b) >= _STEP_M or abs((a.inverse() @ b).theta_rad) >= _STEP_RAD
