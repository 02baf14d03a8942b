"""``amr-slam localize``."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from typing import Any, Final

import numpy as np

from amr_slam.cli.progress import Progress
from amr_slam.cli.wiring import FAILURES, open_source
from amr_slam.clouds import cloud_from_scan
from amr_slam.engine import SlamEngine
from amr_slam.evidence import Answer, Hypothesis
from amr_slam.fusion import error95_m
from amr_slam.geometry import Array, Pose2
from amr_slam.map import load_map
from amr_slam.params import SlamParams
from amr_slam.samples import Scan
from amr_slam.slam_request import SlamRequest, SlamResult

__all__ = ["FAILURES", "run"]

_log = logging.getLogger(__name__)
_SIGMAS: Final = 3.0  # half a search window in standard deviations of the prior


def run(arguments: argparse.Namespace) -> int:
    """One line a scan, as soon as it is known."""
    known, _ = load_map(arguments.map)
    source = open_source(arguments)
    params = source.slam
    engine = SlamEngine(params, known, "localization")
    begun_s = time.perf_counter()
    known.signatures(params.grid_m, params.robot_radius_m, params.rdnm)
    _log.info("map prepared in %.2f s", time.perf_counter() - begun_s)
    previous: Pose2 | None = None
    covariance = _widest_prior(params)
    first_ns, last_ns = source.samples[0].stamp_ns, source.samples[-1].stamp_ns
    with Progress("localize", first_ns, last_ns, quiet=sys.stdout.isatty()) as progress:
        for scan in source.samples:
            if not isinstance(scan, Scan):
                continue
            begun_s = time.perf_counter()
            mounting = source.mountings[scan.scanner]
            cloud = cloud_from_scan(
                mounting.masked(scan),
                mounting.base_from_lidar,
                params.clouds,
                upside_down=mounting.upside_down,
            )
            request = SlamRequest(
                cloud=cloud,
                map_from_base=previous,
                covariance=covariance if previous is not None else None,
            )
            result = engine.update(request)
            line = _line(result, time.perf_counter() - begun_s)
            sys.stdout.write(json.dumps(line, allow_nan=False) + "\n")
            sys.stdout.flush()
            if arguments.prior == "previous" and result.fix is not None:
                previous = result.fix.map_from_base
            progress.at(scan.stamp_ns)
    return 0


def _widest_prior(params: SlamParams) -> Array:
    """Covariance (3, 3) of a pose that is known to the greatest window of the relative strategy:
    nothing tells how far the robot went since."""
    return np.diag((params.window_max / _SIGMAS) ** 2)


def _line(result: SlamResult, elapsed_s: float) -> dict[str, Any]:
    answer, fix = result.answer, result.fix
    if fix is not None:
        best: Pose2 | None = fix.map_from_base
    else:
        best = answer.best.pose if answer.best is not None else None
    return {
        "stamp": result.stamp_ns / 1e9,
        "accepted": fix is not None,
        "x": best.x_m if best is not None else None,
        "y": best.y_m if best is not None else None,
        "theta": best.theta_rad if best is not None else None,
        "covariance": fix.covariance.ravel().tolist() if fix is not None else None,
        "error95_m": error95_m(fix.covariance) if fix is not None else None,
        "score": answer.best.score if answer.best is not None else 0.0,
        "ambiguity": ambiguity(answer),
        "second": _second(answer.second),
        "reason": answer.reason,
        "elapsed_s": elapsed_s,
    }


def ambiguity(answer: Answer) -> float:
    """Score of the second best place over the best one's, 0 to 1: 0 where nothing else comes
    near, 1 where another place fits as well or none fits at all."""
    if answer.best is None or answer.best.score <= 0.0:
        return 1.0
    if answer.second is None:
        return 0.0
    return min(max(answer.second.score / answer.best.score, 0.0), 1.0)


def _second(second: Hypothesis | None) -> dict[str, float] | None:
    if second is None:
        return None
    pose = second.pose
    return {"x": pose.x_m, "y": pose.y_m, "theta": pose.theta_rad, "score": second.score}
