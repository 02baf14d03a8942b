"""``amr-slam replay``."""

from __future__ import annotations

import argparse
import json
import logging
import math
import sys
import time
import uuid
from collections import Counter
from dataclasses import replace
from typing import Any

from amr_slam.cli.outputs import UsageError, check_outputs, writing
from amr_slam.cli.progress import Progress
from amr_slam.cli.wiring import FAILURES, Source, odometry, open_source
from amr_slam.config import load
from amr_slam.engine import SlamEngine
from amr_slam.evaluation import ErrorSummary, absolute_trajectory_error
from amr_slam.fusion import FilterParams
from amr_slam.localizer import Localizer, LocalizerParams
from amr_slam.map import PointMap, load_map, save_map
from amr_slam.recording import Trajectory, write_tum
from amr_slam.replay import ReplayResult, replay
from amr_slam.rerun import rerun
from amr_slam.samples import PoseEstimate, Scan
from amr_slam.slam_request import SlamResult

__all__ = ["FAILURES", "run"]

_log = logging.getLogger(__name__)


def run(arguments: argparse.Namespace) -> int:
    """Replay, write what was asked for, and sum up."""
    if arguments.as_recorded:
        return _as_recorded(arguments)
    mapping = _checked_mapping(arguments)
    begun_s = time.perf_counter()
    source = open_source(arguments)
    read_s = time.perf_counter() - begun_s
    if arguments.map is not None:
        grown = load_map(arguments.map)[0]
    else:
        grown = PointMap(source.slam.map, source.name)
    localizer = _localizer(source, starts_map=arguments.map is None)
    params = source.slam
    if arguments.no_loops:
        params = replace(params, closing=replace(params.closing, enabled=False))
    engine = SlamEngine(params, grown, "mapping" if mapping else "localization")
    if mapping and arguments.map is not None:
        engine.go_on(hold=arguments.hold)
    first_ns, last_ns = source.samples[0].stamp_ns, source.samples[-1].stamp_ns
    with Progress("replay", first_ns, last_ns) as progress:
        result = replay(source.samples, localizer, engine, progress.at)
    engine.settle()
    took_s = time.perf_counter() - begun_s
    map_id = _write(arguments, result, grown)
    estimate = localizer.estimate(last_ns)
    report = _report(source, localizer, result, estimate)
    report["map"] = _map_facts(grown, map_id)
    if source.log.truth is not None:
        # A new map begins where the robot stood, as the truth does; a loaded one has its own frame.
        align = arguments.map is not None
        report["truth"] = _errors(result, source.log.truth, align=align)
    if arguments.report is not None:
        with writing(arguments.report) as path:
            path.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", "utf-8")
    sys.stdout.write(_summary(report))
    speed = source.duration_s / took_s
    sys.stdout.write(f"{took_s:.1f} s (reading {read_s:.1f} s), {speed:.0f} x real time\n")
    return 0


def _as_recorded(arguments: argparse.Namespace) -> int:
    config = load(arguments.config) if arguments.config is not None else None
    result = rerun(arguments.log, config)
    sys.stdout.write(
        f"{arguments.log.name}: {result.same} of {result.poses} poses are those that were "
        f"published, bit for bit; {result.answers} scans were registered\n"
    )
    if result.first_difference is not None:
        sys.stdout.write(f"first difference: {result.first_difference}\n")
    return 0 if result.same == result.poses > 0 else 1


def _checked_mapping(arguments: argparse.Namespace) -> bool:
    mapping = arguments.mapping if arguments.mapping is not None else arguments.map is None
    if not mapping and arguments.map is None:
        raise UsageError("--no-mapping needs a --map to localize in")
    if not mapping and arguments.map_out is not None:
        raise UsageError("--map-out needs --mapping: without it the map stays as it is")
    if arguments.hold and (arguments.map is None or not mapping):
        raise UsageError("--hold needs --map and --mapping: a map that grows on")
    outputs = (arguments.out, arguments.out_final, arguments.map_out, arguments.report)
    check_outputs(*outputs, source=arguments.log)
    return bool(mapping)


def _localizer(source: Source, *, starts_map: bool) -> Localizer:
    config = source.config
    return Localizer(
        config.localizer if config is not None else LocalizerParams(),
        config.fusion if config is not None else FilterParams(),
        source.slam.clouds,
        odometry(source),
        source.mountings,
        # Who goes on with a map stands somewhere in it, not at its origin: it must be searched.
        "mapping" if starts_map else "localization",
    )


def _write(
    arguments: argparse.Namespace, result: ReplayResult, grown: PointMap
) -> uuid.UUID | None:
    for named, trajectory in ((arguments.out, result.online), (arguments.out_final, result.final)):
        if named is not None:
            with writing(named) as path:
                write_tum(path, trajectory)
    if arguments.map_out is None:
        return None
    return save_map(grown, arguments.map_out, keep=arguments.keep)


# -- report: nothing in it depends on the clock or on where files lie ------------------------


def _report(
    source: Source, localizer: Localizer, result: ReplayResult, estimate: PoseEstimate | None
) -> dict[str, Any]:
    answers: dict[str, Counter[str]] = {}
    for one in result.results:
        answers.setdefault(str(one.answer.rung), Counter())[str(one.answer.verdict)] += 1
    return {
        "log": source.path.name,
        "duration_s": source.duration_s,
        "scans_in_log": sum(isinstance(sample, Scan) for sample in source.log.samples),
        "scans_used": sum(isinstance(sample, Scan) for sample in source.samples),
        "poses": len(result.online),
        "registrations": len(result.results),
        "answers": {rung: dict(sorted(counts.items())) for rung, counts in sorted(answers.items())},
        "refused_by_fusion": result.refused,
        "outcomes": dict(sorted(localizer.outcomes.items())),
        "epoch": localizer.filter.epoch if localizer.filter is not None else 0,
        "final_state": str(estimate.state) if estimate is not None else None,
        "final_error95_m": _number(estimate.error95_m) if estimate is not None else None,
        "scans": [_scan(one) for one in result.results],
    }


def _scan(result: SlamResult) -> dict[str, Any]:
    answer = result.answer
    best = answer.best
    return {
        "stamp": result.stamp_ns / 1e9,
        "rung": str(answer.rung),
        "verdict": str(answer.verdict),
        "reason": answer.reason,
        "inserted": result.inserted,
        "margin": _number(answer.margin),
        "score": _number(best.score) if best is not None else None,
        "inliers": _number(best.inliers) if best is not None else None,
        "known": _number(best.known) if best is not None else None,
        "conflict": _number(best.conflict) if best is not None else None,
    }


def _map_facts(grown: PointMap, map_id: uuid.UUID | None) -> dict[str, Any]:
    return {
        "name": grown.name,
        "uuid": str(map_id) if map_id is not None else None,
        "scans": len(grown.path),
        "points": len(grown),
        "area_m2": grown.area_m2(),
    }


def _errors(result: ReplayResult, truth: Trajectory, *, align: bool) -> dict[str, Any]:
    errors: dict[str, Any] = {"aligned": align}
    for name, trajectory in (("online", result.online), ("final", result.final)):
        try:
            error = absolute_trajectory_error(trajectory, truth, align=align)
        except ValueError as reason:
            _log.warning("no comparison with the log's truth: %s", reason)
            continue
        errors[name] = {
            "position_m": _statistics(error.position_m),
            "heading_deg": _statistics(error.heading_deg),
            "matched": error.matched,
        }
    return errors


def _statistics(summary: ErrorSummary) -> dict[str, float]:
    return {
        "rms": summary.rms,
        "median": summary.median,
        "p95": summary.p95,
        "max": summary.max,
    }


def _number(value: float) -> float | None:
    """JSON knows neither infinity nor NaN."""
    return float(value) if math.isfinite(value) else None


def _summary(report: dict[str, Any]) -> str:
    accepted = {rung: counts.get("accepted", 0) for rung, counts in report["answers"].items()}
    by_rung = ", ".join(f"{rung} {count}" for rung, count in accepted.items() if count)
    inserted = sum(scan["inserted"] for scan in report["scans"])
    facts = report["map"]
    text = (
        f"{report['log']}: {report['duration_s']:.0f} s, {report['poses']} poses, "
        f"{report['scans_used']} of {report['scans_in_log']} scans\n"
        f"registered {report['registrations']}: accepted {sum(accepted.values())}"
        f"{f' ({by_rung})' if by_rung else ''}, {inserted} into the map, "
        f"{report['refused_by_fusion']} refused by the fusion\n"
        f"map {facts['name']}: {facts['scans']} scans, {facts['points']} points, "
        f"{facts['area_m2']:.0f} m2 of floor seen\n"
    )
    if report["final_state"] is not None:
        claim = report["final_error95_m"]
        error95 = "error unknown" if claim is None else f"error95 {claim:.3f} m"
        text += f"at the end: {report['final_state']}, {error95}\n"
    for name in ("online", "final"):
        if error := report.get("truth", {}).get(name):
            position, heading = error["position_m"], error["heading_deg"]
            text += (
                f"{name} against the truth: rms {position['rms']:.3f} m {heading['rms']:.2f} deg, "
                f"p95 {position['p95']:.3f} m, max {position['max']:.3f} m\n"
            )
    return text
