"""Are the scanners mounted as configured? Each scan against the map, as seen and rearranged.

A scan that fits as configured asks no question. Where one scanner or both do not fit, each fault
of :mod:`amr_slam.arrangement` is undone in turn: only a fault that makes *all* scanners fit where
the configuration does not is told, so that people, moved furniture and unmapped places are none.
Faults that look like another pose of the robot show in its motion: the scans go another way than
the wheels.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.arrangement import Rearrangement, View, rearrangements, seen_motion
from amr_slam.clouds import Cloud
from amr_slam.evidence import Answer, Verdict, least_witness
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.registration import fit, icp
from amr_slam.registration.alignment import Target
from amr_slam.samples import Motion
from amr_slam.slam import slam_absolute

_AGREES: Final = 0.5
"""Share of the beams that end at the map's first wall, of the scanner that agrees less: so many
must, or nothing is said to fit."""
_LEAD: Final = 0.25
"""By so much more must agree without the fault than with it."""
_LEAD_BY_MOTION: Final = 0.1
"""The same where the scan fits not where the wheels lead, but where a fault would lead it."""
_NEAR: Final = np.array([0.7, 0.35])
"""m and rad: how far a pose may be from the expected one and still be it."""
_APART: Final = np.array([0.3, 0.2])
"""m and rad: two ways that differ by more can be told apart."""
_LONGEST_M: Final = 10.0
"""A way that wheels alone tell no longer well enough."""
_OVERLAP: Final = 0.15
"""Share of a scanner's surface that must stand in what another one saw."""
_SAME_FIT: Final = 0.1


class Looks(enum.StrEnum):
    """What a scan says of the configuration."""

    UNTOLD = "untold"
    RIGHT = "right"
    WRONG = "wrong"


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """Of one scan."""

    looks: Looks = Looks.UNTOLD
    fault: str | None = None
    """WRONG: what would explain it."""
    by_motion: bool = False
    """The way between two scans tells it, not one scan alone."""


class Inspector:
    """Looks at one scan after another of one robot; knows where the last one fitted."""

    def __init__(self, params: SlamParams) -> None:
        self._params = params
        self._anchor: Pose2 | None = None
        self._way = Pose2.identity()
        """What the wheels say since the anchor."""

    def inspect(
        self,
        cloud: Cloud,
        views: Sequence[View],
        expected: Pose2 | None,
        motion: Motion | None,
        answer: Answer,
        known: PointMap,
        *,
        mapping: bool,
    ) -> Inspection:
        """``expected``: where the fusion has the robot. ``motion``: of the wheels since the last
        scan that was inspected. ``answer``: the registration's word on the scan as it is."""
        self._carry(motion)
        if not views or not len(cloud) or not len(known):
            return Inspection()
        target = known.target() if expected is None or not mapping else known.target(expected)
        best = answer.best
        accepted = answer.verdict is Verdict.ACCEPTED and best is not None
        found = best.pose if accepted and best is not None else None
        fits = found is not None and best is not None and best.agreeing >= _AGREES
        faults = rearrangements(views)
        moved = self._by_motion(cloud, target, found if fits else None, faults, mapping=mapping)
        if moved.looks is Looks.UNTOLD:
            near = found is not None and (expected is None or _is_near(found, expected, _NEAR))
            if fits and near:
                moved = Inspection(looks=Looks.RIGHT)
            else:
                moved = self._by_fit(cloud, target, expected, answer, known, faults)
        if fits and self._anchor is None:
            self._anchor, self._way = found, Pose2.identity()
        return moved

    def founding(self, cloud: Cloud, views: Sequence[View], pose: Pose2) -> Inspection:
        """Whether scanners whose views overlap draw one and the same place: what a new map is
        founded on has no other witness. Which of two is mirrored may stay open. ``pose``: where
        the robot stands in the new map."""
        self._anchor, self._way = pose, Pose2.identity()
        if len(views) < 2 or not len(cloud):
            return Inspection()
        seen = self._mutual(cloud)
        if seen is None or seen[1] < _LEAD:
            return Inspection()
        better: list[tuple[float, str]] = []
        for fault in rearrangements(views):
            told = self._mutual(fault.apply(cloud)) if fault.common is None else None
            if told is not None and told[0] >= max(0.6, seen[0] + _LEAD):
                better.append((told[0], fault.name))
        if not better:
            return Inspection()
        most = max(fit for fit, _ in better)
        names = [name for fit, name in sorted(better, reverse=True) if fit > most - _SAME_FIT]
        return Inspection(looks=Looks.WRONG, fault=", or ".join(names[:2]))

    # -- the way of the scans against the way of the wheels ----------------------------------

    def _carry(self, motion: Motion | None) -> None:
        if motion is None or motion.gap:
            self._anchor = None
            return
        self._way = self._way @ motion.delta
        if self._way.distance_to(Pose2.identity()) > _LONGEST_M:
            self._anchor = None

    def _by_motion(
        self,
        cloud: Cloud,
        target: Target,
        found: Pose2 | None,
        faults: Sequence[Rearrangement],
        *,
        mapping: bool,
    ) -> Inspection:
        """``found``: where the scan as it is was accepted and fits."""
        if self._anchor is None:
            return Inspection()
        straight = self._anchor @ self._way
        twisted: list[tuple[Pose2, str]] = []
        for fault in faults:
            common = fault.common
            # A map that is known is not mirrored: there a mirrored scan does not fit at all.
            if common is None or (np.linalg.det(common) < 0.0 and not mapping):
                continue
            pose = self._anchor @ seen_motion(self._way, common)
            if not _is_near(pose, straight, _APART):
                twisted.append((pose, fault.name))
        if not twisted:
            return Inspection()
        if found is not None and _is_near(found, straight, 0.5 * _APART):
            self._anchor, self._way = found, Pose2.identity()
            return Inspection(looks=Looks.RIGHT, by_motion=True)
        for pose, name in twisted if found is not None else ():
            if found is not None and _is_near(found, pose, 0.5 * _APART):
                self._anchor, self._way = found, Pose2.identity()
                return Inspection(looks=Looks.WRONG, fault=name, by_motion=True)
        starts = [straight, *(pose for pose, _ in twisted)]
        ends, agreeing = self._refined(cloud, target, starts)
        best = int(np.argmax(agreeing))
        here = max(
            (a for end, a in zip(ends, agreeing, strict=True) if _is_near(end, straight, _APART)),
            default=0.0,
        )
        told = best > 0 and agreeing[best] >= max(_AGREES, here + _LEAD_BY_MOTION)
        if not told or not _is_near(ends[best], starts[best], 0.7 * _APART):
            # Neither way: the robot was carried, the wheels slipped, or the fault is over.
            self._anchor, self._way = found, Pose2.identity()
            return Inspection()
        self._anchor, self._way = ends[best], Pose2.identity()
        return Inspection(looks=Looks.WRONG, fault=twisted[best - 1][1], by_motion=True)

    # -- the fit with and without each fault -------------------------------------------------

    def _by_fit(
        self,
        cloud: Cloud,
        target: Target,
        expected: Pose2 | None,
        answer: Answer,
        known: PointMap,
        faults: Sequence[Rearrangement],
    ) -> Inspection:
        elsewhere = [place.agreeing for place in answer.places]
        near = [0.0]
        if expected is not None:
            near += self._refined(cloud, target, [expected])[1]
            near += [p.agreeing for p in answer.places if _is_near(p.pose, expected, _NEAR)]
            trials = iter([(fault, expected) for fault in faults])
        else:
            trials = self._sought(cloud, known, faults)
        found: list[tuple[float, str]] = []
        for fault, start in trials:
            bar = max(near if fault.is_rigid else [*near, *elsewhere]) + _LEAD
            (end,), (agreeing,) = self._refined(fault.apply(cloud), target, [start])
            if agreeing >= max(_AGREES, bar) and _is_near(end, start, _NEAR):
                found.append((agreeing, fault.name))
        if not found:
            return Inspection()
        return Inspection(looks=Looks.WRONG, fault=max(found)[1])

    def _sought(
        self, cloud: Cloud, known: PointMap, faults: Sequence[Rearrangement]
    ) -> Iterator[tuple[Rearrangement, Pose2]]:
        """Faults with the places where a robot of unknown pose would be: one scanner alone is
        sought in the whole map, then the others are tried beside it."""
        told = [fault for fault in faults if not fault.is_rigid]
        scanners = np.unique(cloud.scanners)
        for scanner in scanners if len(scanners) > 1 else ():
            alone = cloud.take(np.flatnonzero(cloud.scanners == scanner))
            place = self._accepted(alone, known)
            for fault in told if place is not None else ():
                there = fault.true_base(int(scanner))
                if place is not None and there is not None:
                    yield fault, place @ there
        for fault in told:
            if all(fault.true_base(int(scanner)) is None for scanner in scanners):
                place = self._accepted(fault.apply(cloud), known)
                if place is not None:
                    yield fault, place

    def _accepted(self, cloud: Cloud, known: PointMap) -> Pose2 | None:
        answer = slam_absolute(cloud, known, self._params)
        accepted = answer.verdict is Verdict.ACCEPTED and answer.best is not None
        return answer.best.pose if accepted and answer.best is not None else None

    def _refined(
        self, cloud: Cloud, target: Target, starts: Sequence[Pose2]
    ) -> tuple[list[Pose2], list[float]]:
        """Where ICP ends from each start, and the agreement of the least witness there."""
        part = cloud.take(cloud.even(self._params.first_points))
        rows = np.array([start.as_array() for start in starts])
        ends = [Pose2.from_array(row) for row in _refine(part, target, rows, self._params)]
        tolerance_m = max(self._params.fit_m, 2.5 * cloud.sigma_m)
        agreeing = [
            least_witness(cloud, np.abs(fit.beyond_walls(cloud, target, end)) <= tolerance_m)
            for end in ends
        ]
        return ends, agreeing

    def _mutual(self, cloud: Cloud) -> tuple[float, float] | None:
        """(share on walls, share in free space) of each scanner's points where the others have
        seen anything; None where too little of them overlaps."""
        on_wall = free = shared = 0.0
        for scanner in np.unique(cloud.scanners):
            own = np.flatnonzero(cloud.scanners == scanner)
            others = PointMap(self._params.map)
            others.insert(cloud.take(np.flatnonzero(cloud.scanners != scanner)), Pose2.identity())
            if not len(others):
                return None
            target = others.target()
            points = cloud.take(own)
            distance = fit.distances(target, points.points_m)
            share = points.weights / points.weights.sum()
            on = distance <= fit.clearance(points)
            within = target.lookup.seen_free(points.points_m) & ~on
            on_wall, free = on_wall + float(share @ on), free + float(share @ within)
            shared += float(share @ (on | within))
        if shared < 2.0 * _OVERLAP:
            return None
        return on_wall / shared, free / shared


def _refine(part: Cloud, target: Target, rows: Array, params: SlamParams) -> Array:
    return icp.refine(part, target, rows, params.icp).poses


def _is_near(a: Pose2, b: Pose2, within: Array) -> bool:
    off = np.array([a.distance_to(b), abs(wrap_angle(a.theta_rad - b.theta_rad))])
    return bool(np.all(off <= within))
