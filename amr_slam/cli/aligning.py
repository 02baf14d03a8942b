"""``amr-slam map align``."""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from amr_slam.aligning import (
    AlignError,
    FitParams,
    FloorPlan,
    PlanFit,
    PlanParams,
    fit_pairs,
    fit_plan,
    fit_tracks,
    read_camera,
    read_landmarks,
    read_pairs,
    read_plan,
    write_residuals,
)
from amr_slam.aligning.report import pairs_report, plan_report
from amr_slam.cli.outputs import UsageError, check_outputs, writing
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap, Reframing, load_map, moved, save_map
from amr_slam.recording import read_tum

_NOTHING: Array = np.empty((0, 2))
_MOST_ARROWS = 250


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Aligned:
    """One way or the other: what came out."""

    site_from_map: Pose2
    by: str
    rms_m: float
    used: int
    left_out: int
    scale: float
    report: str
    problems: tuple[str, ...]
    plan_m: Array
    """(n, 2) the floor plan's walls, in the site's frame."""
    arrows: tuple[Array, Array]
    """(k, 2) points in the site's frame and what is left at each (k, 2)."""
    strangers_m: Array
    """(j, 2) what was left out."""


def align(arguments: argparse.Namespace) -> int:
    """Find the transform, say what it is worth, and save the map in the new frame."""
    _check(arguments)
    known, map_id = load_map(arguments.map)
    by_plan = arguments.floor_plan is not None
    found = _by_plan(arguments, known) if by_plan else _by_pairs(arguments, str(map_id))
    sys.stdout.write(found.report)
    problems = found.problems
    if not found.rms_m <= arguments.max_rms:
        left = f"{found.rms_m:.3f} m rms are left between both, --max-rms is {arguments.max_rms:g}"
        problems = (*problems, left)
    fresh = moved(known, found.site_from_map)
    fresh.name = arguments.name or arguments.out.stem
    fresh.reframings = (*known.reframings, _reframing(found, str(map_id)))
    if arguments.picture is not None:
        _draw(arguments.picture, fresh, found)
    if problems:
        raise AlignError(f"{arguments.map}: not aligned: {'; '.join(problems)}")
    new_id = save_map(fresh, arguments.out)
    sys.stdout.write(f"{arguments.out}: {fresh.name}, {new_id}\n")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Raises UsageError."""
    sources = {
        name: getattr(arguments, name)
        for name in ("pairs", "camera", "slam", "landmarks", "floor_plan")
    }
    outputs = (arguments.out, arguments.picture, arguments.residuals)
    for source in (arguments.map, *filter(None, sources.values())):
        check_outputs(*outputs, source=source)
    if (arguments.camera is None) != (arguments.slam is None):
        raise UsageError("--camera and --slam belong together: the same drive, seen by both")
    if arguments.clock is not None and arguments.camera is None:
        raise UsageError("--clock belongs to --camera")
    if arguments.marker is not None and arguments.pairs is None and arguments.camera is None:
        raise UsageError("--marker belongs to --pairs or --camera")
    for name in ("resolution", "origin", "near"):
        if getattr(arguments, name) is not None and arguments.floor_plan is None:
            raise UsageError(f"--{name} belongs to --floor-plan")
    if arguments.residuals is not None and arguments.floor_plan is not None:
        raise UsageError("--residuals belongs to pairs and landmarks")


def _by_pairs(arguments: argparse.Namespace, map_id: str) -> _Aligned:
    params, marker = FitParams(), _pose(arguments.marker)
    clock_s: float | None = None
    if arguments.camera is not None:
        camera, known = read_camera(arguments.camera), read_tum(arguments.slam)
        timed = fit_tracks(camera, known, params, marker, arguments.clock)
        pairs, fit, clock_s = timed.pairs, timed.fit, timed.clock_s
        source: Path = arguments.camera
    elif arguments.pairs is not None:
        source = arguments.pairs
        pairs = read_pairs(source, map_id)
        fit = fit_pairs(pairs, params, marker)
        clock_s = fit.clock_s if fit.clock_sigma_s is not None else None
    else:
        source = arguments.landmarks
        pairs = read_landmarks(source)
        fit = fit_pairs(pairs, params, ordered=False)
    if arguments.residuals is not None:
        with writing(arguments.residuals) as path:
            write_residuals(path, pairs, fit)
    at = pairs.site[:, :2] - fit.offsets_m
    shown = np.flatnonzero(fit.agrees)
    shown = shown[:: max(1, -(-len(shown) // _MOST_ARROWS))]
    return _Aligned(
        site_from_map=fit.site_from_map,
        by=source.name[:100],
        rms_m=fit.rms_m,
        used=int(fit.agrees.sum()),
        left_out=int((~fit.agrees).sum()),
        scale=fit.scale,
        report=pairs_report(pairs, fit, clock_s),
        problems=fit.problems,
        plan_m=_NOTHING,
        arrows=(at[shown], fit.offsets_m[shown]),
        strangers_m=pairs.site[~fit.agrees, :2],
    )


def _by_plan(arguments: argparse.Namespace, known: PointMap) -> _Aligned:
    plan = read_plan(arguments.floor_plan, arguments.resolution, _pose(arguments.origin))
    fit = fit_plan(known, plan, PlanParams(), _pose(arguments.near))
    return _of_plan(arguments.floor_plan, plan, fit)


def _of_plan(source: Path, plan: FloorPlan, fit: PlanFit) -> _Aligned:
    exact = fit.exact
    return _Aligned(
        site_from_map=exact.site_from_map,
        by=source.name[:100],
        rms_m=exact.rms_m,
        used=len(exact.points_m),
        left_out=0,
        scale=exact.scale,
        report=plan_report(fit),
        problems=fit.problems,
        plan_m=plan.points_m,
        arrows=(_NOTHING, _NOTHING),
        strangers_m=_NOTHING,
    )


def _reframing(found: _Aligned, map_id: str) -> Reframing:
    pose = found.site_from_map
    return Reframing(
        map_id=map_id,
        by=found.by,
        x_m=pose.x_m,
        y_m=pose.y_m,
        theta_rad=pose.theta_rad,
        rms_m=found.rms_m,
        used=found.used,
        left_out=found.left_out,
        scale=found.scale,
    )


def _draw(picture: Path, fresh: PointMap, found: _Aligned) -> None:
    from amr_slam.pictures import draw_alignment  # noqa: PLC0415 - half a second, for pictures only

    title = f"{fresh.name}: by {found.by}, rms {100.0 * found.rms_m:.1f} cm"
    with writing(picture) as out:
        draw_alignment(fresh, found.plan_m, found.arrows, found.strangers_m, out, title)


def _pose(given: tuple[float, float, float] | None) -> Pose2 | None:
    if given is None:
        return None
    x_m, y_m, theta_deg = given
    return Pose2(x_m, y_m, math.radians(theta_deg))
