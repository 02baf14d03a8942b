"""Absolute localization of recorded scans in maps of other passes, one flat record each.

:func:`evidence` serves the study's tables and the choice of acceptance thresholds alike.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.slam import Answer, slam_absolute
from amr_slam.studies.real_passes import COVERED, Pass, Recording, Visit, passes
from amr_slam.studies.scenes import is_right
from amr_slam.studies.trials import Circumstances, Trial, judged


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """One scan, sought anywhere in a map of other passes."""

    log: str
    part: int
    """Of the recording."""
    stamp_ns: int
    grid_m: float
    reference: Pose2
    """map_from_base."""
    covered: float
    """Share of the scan's points on mapped walls."""
    places: int
    """Distinct places that were found."""
    rank: int | None
    """Of the right one among them, 1 for the best; None where it is not among them."""
    findable: bool
    """The right place is the best, or would be if the reference pose were among the candidates:
    where this is not so, another place fits better, and no longer search would help."""
    trial: Trial
    """The best place's evidence, its error against the reference, verdict and time."""

    @property
    def right(self) -> bool:
        """The best place is the right one."""
        return self.trial.right


def evidence(
    recording: Recording,
    params: SlamParams,
    grids_m: Sequence[float],
    count: int,
    seed: int = 0,
    *,
    covered: tuple[float, float] = (COVERED, 1.0),
) -> Iterator[Query]:
    """At most ``count`` scans whose covered share lies in ``covered``, each sought at every grid
    spacing. ``(0.0, 0.3)`` gives scans of which the map knows hardly anything."""
    parts = passes(recording.visits)
    for number, (one, rows) in enumerate(
        zip(parts, choose(parts, count, seed, covered), strict=True)
    ):
        if rows:
            yield from ask(recording.name, number, one, rows, one.map(params), params, grids_m)


def choose(
    parts: Sequence[Pass], count: int, seed: int, covered: tuple[float, float] = (COVERED, 1.0)
) -> list[list[int]]:
    """Rows of each part's asked scans: ``count`` of all parts, drawn without preference from
    those whose covered share lies in ``covered``."""
    low, high = covered
    pool = [
        (number, row)
        for number, one in enumerate(parts)
        for row, share in enumerate(one.covered)
        if low <= share <= high
    ]
    drawn = np.random.default_rng(seed).permutation(len(pool))[:count]
    chosen: list[list[int]] = [[] for _ in parts]
    for k in np.sort(drawn):
        number, row = pool[k]
        chosen[number].append(row)
    return chosen


def ask(
    log: str,
    part: int,
    one: Pass,
    rows: Sequence[int],
    known: PointMap,
    params: SlamParams,
    grids_m: Sequence[float],
) -> Iterator[Query]:
    """Seek these of the part's scans in its map, at each grid spacing."""
    if not len(rows):
        return
    for grid_m in grids_m:
        spaced = replace(params, grid_m=grid_m)
        # What a map prepares once is not part of any scan's time.
        slam_absolute(one.asked[rows[0]].cloud, known, spaced)
        for row in rows:
            yield _sought(log, part, one.asked[row], float(one.covered[row]), known, spaced)


def _sought(
    log: str, part: int, visit: Visit, covered: float, known: PointMap, params: SlamParams
) -> Query:
    begun_s = time.process_time()
    answer = slam_absolute(visit.cloud, known, params)
    ms = 1e3 * (time.process_time() - begun_s)
    under = Circumstances(kind=log, seed=part, sigma_m=visit.cloud.sigma_m)
    trial = judged(answer, visit.pose, under, ms)
    findable = trial.right
    if not findable:
        helped = slam_absolute(visit.cloud, known, params, np.array([visit.pose.as_array()]))
        findable = rank_of(helped, visit.pose) == 1
    return Query(
        log=log,
        part=part,
        stamp_ns=visit.stamp_ns,
        grid_m=params.grid_m,
        reference=visit.pose,
        covered=covered,
        places=len(answer.places),
        rank=rank_of(answer, visit.pose),
        findable=findable,
        trial=trial,
    )


def rank_of(answer: Answer, truth: Pose2) -> int | None:
    """Which of the answer's places is the right one (0.25 m, 5 degrees), 1 for the best."""
    ranks = [k for k, place in enumerate(answer.places, 1) if is_right(place.pose, truth)]
    return ranks[0] if ranks else None
