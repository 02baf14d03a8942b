"""Is what a commissioning report says true? ``python benchmarks/map_report.py [KIND ...]``

For each kind of simulated world: a map from scans at true poses, a report of it, and then the same
poses in the *world*, which the report never saw: how far off localization really is against the
expected error, whether cold starts come out as foretold, and what a suggested box does once it
stands in the world and the place was mapped again. Times are processor seconds of one report.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.commissioning import Report, ReportParams, make_report, usual_eyes
from amr_slam.commissioning.cold_starts import Outcome, Switchboard
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap, save_map
from amr_slam.params import SlamParams
from amr_slam.simulation import World, mapping_poses
from amr_slam.simulation.shapes import edges
from amr_slam.slam_request import SlamRequest
from amr_slam.studies.scenes import seen_by_both
from amr_slam.studies.worlds import KINDS

_WORLDS: Final = {
    "hall": (3, 400.0),
    "offices": (2, 300.0),
    "corridors": (1, 200.0),
    "odd": (1, 200.0),
    "symmetric": (1, 160.0),
}
_POSES: Final = 60
_SLAM: Final = SlamParams()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Checked:
    """Of the poses at which the report foretold something."""

    within: float
    """Share of the errors within the expected radius of 95 %."""
    factor: float
    """95 % of the errors are within this many expected radii."""
    expected_m: float
    """Median of the expected errors; and of what 95 % stay within, were they all alike:"""
    measured_m: float
    foretold: float
    """Share of the cold starts that were to be located at once ..."""
    located: float
    """... and that were, at the same poses."""
    alike_alike: tuple[int, int]
    """Of the poses that the report called alike, those not located in the world either; all."""
    wrong: int


def main(arguments: Sequence[str] | None = None) -> None:
    """One line a world."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=list(_WORLDS), metavar="KIND")
    parser.add_argument("--maps", type=Path, metavar="FOLDER", help="keep the maps there")
    chosen = parser.parse_args(arguments)
    print(
        "| world | within 95 % radius | factor | expected median, mm | measured 95 %, mm "
        "| located: foretold / in the world | alike, so in the world | wrong | CPU s |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    for kind in chosen.kinds:
        seed, area_m2 = _WORLDS[kind]
        world = KINDS[kind](seed, area_m2)
        known = _mapped(world, f"{kind} {area_m2:g} m2")
        if chosen.maps is not None:
            save_map(known, chosen.maps / f"{kind}.amrmap")
        begun_s = time.process_time()
        params = ReportParams(cold_starts=_POSES, suspects=20, precision_places=400)
        report = make_report(known, usual_eyes(), _SLAM, params, lambda *_: None)
        cpu_s = time.process_time() - begun_s
        seen = _checked(report, world)
        print(
            f"| {kind} {area_m2:g} m² | {seen.within:.1%} | {seen.factor:.2f} "
            f"| {1e3 * seen.expected_m:.1f} | {1e3 * seen.measured_m:.1f} "
            f"| {seen.foretold:.0%} / {seen.located:.0%} "
            f"| {seen.alike_alike[0]} of {seen.alike_alike[1]} | {seen.wrong} | {cpu_s:.0f} |",
            flush=True,
        )
        _boxes(report, world)


def _mapped(world: World, name: str) -> PointMap:
    known, rng = PointMap(_SLAM.map, name), np.random.default_rng(world.seed)
    for pose in mapping_poses(world, 1.0):
        known.insert(seen_by_both(world, pose, rng), pose)
    return known


def _checked(report: Report, world: World) -> _Checked:
    rng = np.random.default_rng(7)
    engine = SlamEngine(_SLAM, report.known, "localization")
    exact = report.precision
    rows = np.linspace(0, len(exact.poses) - 1, 200).astype(np.intp)
    errors = []
    for row in rows:
        truth = Pose2.from_array(exact.poses[row])
        covariance = np.diag([0.1**2, 0.1**2, 0.05**2])
        near = truth @ Pose2.from_array(rng.multivariate_normal(np.zeros(3), covariance))
        request = SlamRequest(
            cloud=seen_by_both(world, truth, rng), map_from_base=near, covariance=covariance
        )
        fix = engine.update(request).fix
        errors.append(np.nan if fix is None else fix.map_from_base.distance_to(truth))
    off, expected = np.array(errors), exact.error95_m[rows]
    known = np.isfinite(off)
    off, expected = off[known], expected[known]
    board = Switchboard(report.known, report.eyes, report.slam, report.params)
    outcomes = []
    for one in report.starts.tried:
        request = SlamRequest(
            cloud=seen_by_both(world, one.truth, rng), map_from_base=None, covariance=None
        )
        again = board.judged(engine.update(request).answer, one.truth, even=one.even)
        outcomes.append((one, again.outcome))
    even = [outcome for one, outcome in outcomes if one.even]
    alike = [outcome for one, outcome in outcomes if one.outcome is Outcome.ALIKE]
    return _Checked(
        within=float(np.mean(off <= expected)),
        factor=float(np.quantile(off / expected, 0.95)),
        expected_m=float(np.median(expected)),
        measured_m=float(np.quantile(off, 0.95)),
        foretold=report.starts.share(Outcome.LOCATED),
        located=even.count(Outcome.LOCATED) / len(even),
        alike_alike=(len(alike) - alike.count(Outcome.LOCATED), len(alike)),
        wrong=[outcome for _, outcome in outcomes].count(Outcome.WRONG),
    )


def _boxes(report: Report, world: World) -> None:
    """The suggested boxes in the world, and the place mapped again."""
    boxes = [one.box for one in report.resolutions if one.box is not None]
    if report.together is None:
        return
    with_boxes = replace(
        world, segments_m=np.concatenate([world.segments_m, *(edges(b.corners_m) for b in boxes)])
    )
    known = _mapped(with_boxes, "with boxes")
    engine, rng = SlamEngine(_SLAM, known, "localization"), np.random.default_rng(8)
    board = Switchboard(known, report.eyes, report.slam, report.params)
    starts = list({c.start: None for pair in report.pairs for c in pair.confused})
    outcomes = []
    for one in starts:
        cloud = seen_by_both(with_boxes, one.truth, rng)
        request = SlamRequest(cloud=cloud, map_from_base=None, covariance=None)
        outcomes.append(board.judged(engine.update(request).answer, one.truth, even=True).outcome)
    said = report.together
    print(
        f"{len(boxes)} boxes: foretold {said.located} + {said.unsure} unsure of {said.poses}; "
        f"in the world {outcomes.count(Outcome.LOCATED)} + {outcomes.count(Outcome.UNSURE)} of "
        f"{len(outcomes)}, wrong {outcomes.count(Outcome.WRONG)}",
        flush=True,
    )


if __name__ == "__main__":
    main()
