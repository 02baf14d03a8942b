"""One absolute localization as a flat record, and what many of them say together.

The same records serve the tables and the choice of acceptance thresholds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.slam import Answer, Verdict, slam_absolute
from amr_slam.studies.scenes import RIGHT_M, RIGHT_RAD, pose_error


@dataclass(frozen=True, slots=True, kw_only=True)
class Circumstances:
    """Under what a trial was made."""

    kind: str
    """Of world."""
    seed: int
    """Of the mapped world."""
    sigma_m: float
    """Noise in x and y of each point, of the map's scans as well."""
    negative: bool = False
    """The robot stands where the map knows nothing, or in another world."""
    blocked: float = 0.0
    """Share of the beams that something unmapped blocks."""
    moved: float = 0.0
    """Share of the furniture that was moved after mapping."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What the absolute strategy answered to one scan; NaN where it found no place at all."""

    under: Circumstances
    verdict: Verdict
    pose: Pose2 | None
    """The best place, accepted or not."""
    error_m: float
    """Of the best place; inf in another world."""
    error_rad: float
    score: float
    inliers: float
    known: float
    conflict: float
    passes: float
    agreeing: float
    e_psr_m: float
    margin: float
    odds: float
    """How probable the best place is said to be."""
    ms: float
    """Processor time."""

    @property
    def right(self) -> bool:
        """The best place is the true one, within 0.25 m and 5 degrees."""
        return self.error_m <= RIGHT_M and self.error_rad <= RIGHT_RAD

    @property
    def accepted(self) -> bool:
        return self.verdict is Verdict.ACCEPTED

    @property
    def wrongly_accepted(self) -> bool:
        return self.accepted and not self.right


def localize(
    cloud: Cloud, known: PointMap, params: SlamParams, truth: Pose2 | None, under: Circumstances
) -> Trial:
    """The absolute strategy on one cloud. ``truth``: map_from_base; None: in another world."""
    begun_s = time.process_time()
    answer = slam_absolute(cloud, known, params)
    return judged(answer, truth, under, 1e3 * (time.process_time() - begun_s))


def judged(answer: Answer, truth: Pose2 | None, under: Circumstances, ms: float) -> Trial:
    """An answer against the truth."""
    best = answer.best
    if best is None or truth is None:
        error_m = error_rad = math.inf
    else:
        error_m, error_rad = pose_error(best.pose, truth)
    return Trial(
        under=under,
        verdict=answer.verdict,
        pose=best.pose if best else None,
        error_m=error_m,
        error_rad=error_rad,
        score=best.score if best else math.nan,
        inliers=best.inliers if best else math.nan,
        known=best.known if best else math.nan,
        conflict=best.conflict if best else math.nan,
        passes=best.passes if best else math.nan,
        agreeing=best.agreeing if best else math.nan,
        e_psr_m=best.e_psr_m if best else math.nan,
        margin=answer.margin,
        odds=answer.odds[0] if answer.odds else math.nan,
        ms=ms,
    )


def percent(some: int, of: int) -> str:
    """A share, with as many digits as the number of trials carries; "-" of none."""
    if of == 0:
        return "-"
    return f"{100.0 * some / of:.{2 if of >= 5000 else 1}f} %"


def success(trials: Sequence[Trial]) -> str:
    """How often the best place is the true one."""
    return percent(sum(t.right for t in trials), len(trials))


def verdicts(trials: Sequence[Trial]) -> tuple[str, str, str, str]:
    """Accepted, ambiguous, unknown, and wrongly accepted (these by their number)."""
    of = len(trials)
    count = {verdict: sum(t.verdict is verdict for t in trials) for verdict in Verdict}
    return (
        percent(count[Verdict.ACCEPTED], of),
        percent(count[Verdict.AMBIGUOUS], of),
        percent(count[Verdict.UNKNOWN], of),
        str(sum(t.wrongly_accepted for t in trials)),
    )


def mean_and_std(values_m: Iterable[float]) -> tuple[str, str]:
    """In m, of the finite ones; "-" of none."""
    values = np.array(list(values_m))
    values = values[np.isfinite(values)]
    if not len(values):
        return "-", "-"
    return f"{values.mean():.3f}", f"{values.std():.3f}"


def error_mm(trials: Sequence[Trial]) -> str:
    """Root mean square distance of the right ones in mm."""
    errors = np.array([t.error_m for t in trials if t.right])
    return f"{1e3 * math.sqrt(float(np.mean(errors**2))):.1f}" if len(errors) else "-"


def milliseconds(trials: Sequence[Trial]) -> tuple[str, str]:
    """Median and 99th percentile of the time of one trial."""
    median, p99 = np.quantile([t.ms for t in trials], (0.5, 0.99))
    return f"{median:.1f}", f"{p99:.1f}"
