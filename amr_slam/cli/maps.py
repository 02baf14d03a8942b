"""``amr-slam map ...``."""

from __future__ import annotations

import argparse
import importlib
import json
import math
import sys
import uuid
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from amr_slam.aligning import AlignError
from amr_slam.cli import living
from amr_slam.cli.outputs import UsageError, check_outputs, writing
from amr_slam.map import LayerError, MapError, PointMap, load_map, save_map
from amr_slam.map.export import (
    write_graph,
    write_occupancy,
    write_points_csv,
    write_points_ply,
)
from amr_slam.map.file import VERSION
from amr_slam.map.provenance import merged_to_header, to_header
from amr_slam.recording import RecordingError, Trajectory, write_tum

FAILURES: Final[dict[type[Exception], int]] = {
    UsageError: 2,
    MapError: 1,
    LayerError: 1,
    AlignError: 1,
    RecordingError: 1,
    **living.FAILURES,
}

_OF_THEIR_OWN: Final = {
    "align": "amr_slam.cli.aligning",
    "edit": "amr_slam.cli.editing",
    "merge": "amr_slam.cli.merging",
    "report": "amr_slam.cli.reporting",
}
"""Module with the function of that name: what these need is imported for them alone."""


def run(arguments: argparse.Namespace) -> int:
    """Load the map, then what is asked."""
    if arguments.action in _OF_THEIR_OWN:
        command = importlib.import_module(_OF_THEIR_OWN[arguments.action])
        status: int = getattr(command, arguments.action)(arguments)
        return status
    if arguments.action in living.ACTIONS:
        return living.run(arguments)
    if arguments.action != "info":
        check_outputs(arguments.out, source=arguments.map)
    if arguments.action == "import":
        _import(arguments)
        return 0
    known, map_id = load_map(arguments.map)
    if arguments.action == "info":
        _info(arguments, known, map_id)
    elif arguments.action == "render":
        _render(arguments, known)
    else:
        _export(arguments, known)
    return 0


def _import(arguments: argparse.Namespace) -> None:
    from amr_slam.map.importing import import_map  # noqa: PLC0415 - Pillow, for this alone

    known = import_map(arguments.map, arguments.name or arguments.out.stem)
    map_id = save_map(known, arguments.out)
    sys.stdout.write(
        f"{arguments.out}: {len(known)} wall points, {known.area_m2():.1f} m2 of floor, "
        f"walls known to {known.error_m:g} m; map {map_id}\n"
    )


def _info(arguments: argparse.Namespace, known: PointMap, map_id: uuid.UUID) -> None:
    x_min, y_min, x_max, y_max = known.bounds()
    facts: dict[str, Any] = {
        "uuid": str(map_id),
        "name": known.name,
        "format": VERSION,
        "bytes": arguments.map.stat().st_size,
        "scans": len(known.path),
        "points": len(known),
        "area_m2": round(known.area_m2(), 3),
        "bounds_m": [round(bound, 3) for bound in (x_min, y_min, x_max, y_max)],
    }
    if known.imported is not None:
        facts["imported"] = asdict(known.imported)
    if known.layers:
        facts["layers"] = len(known.layers)
    if known.reframings:
        facts["reframings"] = to_header(known.reframings)
    if known.merged:
        facts["merged"] = merged_to_header(known.merged)
    if arguments.json:
        sys.stdout.write(json.dumps(facts) + "\n")
        return
    facts["area_m2"] = f"{known.area_m2():.1f} (floor seen free)"
    facts["bounds_m"] = f"x {x_min:.2f} to {x_max:.2f}, y {y_min:.2f} to {y_max:.2f}"
    facts.pop("reframings", None)
    facts.pop("merged", None)
    if known.imported is not None:
        facts["imported"] = (
            f"from {known.imported.source}: cells of {known.imported.resolution_m:g} m, walls "
            f"known to {known.imported.error_m:g} m"
        )
    for name, value in facts.items():
        sys.stdout.write(f"{name:10}{value}\n")
    for one in known.reframings:
        theta_deg = math.degrees(one.theta_rad)
        sys.stdout.write(
            f"aligned   from {one.map_id} by {one.by}: "
            f"x {one.x_m:+.3f} m, y {one.y_m:+.3f} m, theta {theta_deg:+.3f} deg; "
            f"rms {one.rms_m:.3f} m, {one.used} used, {one.left_out} left out\n"
        )
    for joined in known.merged:
        theta_deg = math.degrees(joined.theta_rad)
        sys.stdout.write(
            f"merged    with {joined.name}, {joined.map_id}: {joined.scans} scans, from "
            f"x {joined.x_m:+.3f} m, y {joined.y_m:+.3f} m, theta {theta_deg:+.3f} deg; "
            f"{joined.common_m2:.0f} m2 in common, rms {joined.rms_m:.3f} m\n"
        )


def _render(arguments: argparse.Namespace, known: PointMap) -> None:
    from amr_slam.pictures import draw_map  # noqa: PLC0415 - half a second, for pictures only

    path = np.array([pose.as_array()[:2] for _, pose in known.path]).reshape(-1, 2)
    paths = [("path of the scans", path)] if len(path) else []
    title = f"{known.name}: {known.area_m2():.0f} m² of floor, {len(known.path)} scans"
    with writing(arguments.out) as out:
        draw_map(known, paths, out, title)


def _export(arguments: argparse.Namespace, known: PointMap) -> None:
    if arguments.resolution is not None and arguments.out.suffix != ".pgm":
        raise UsageError("--resolution is of the pixels of a .pgm")
    with writing(arguments.out) as out:
        match out.suffix:
            case ".pgm":
                image, described = write_occupancy(known, out, arguments.resolution)
                rows, columns = image.pixels.shape
                said = f"{columns} x {rows} pixels of {image.resolution_m:g} m, and {described}"
            case ".csv":
                said = f"{write_points_csv(known, out)} points"
            case ".ply":
                said = f"{write_points_ply(known, out)} points"
            case ".g2o":
                poses, pairs = write_graph(known, out)
                said = f"{poses} poses, {pairs} pairs"
            case _:
                write_tum(out, _path(known))
                said = f"{len(known.path)} poses"
    sys.stdout.write(f"{arguments.out}: {said}\n")


def _path(known: PointMap) -> Trajectory:
    """In the order of time: a map that went on in an older recording's time is not in it."""
    ordered = sorted(known.path, key=lambda entry: entry[0])
    return Trajectory(
        stamps_ns=np.array([stamp for stamp, _ in ordered], dtype=np.int64),
        poses=np.array([pose.as_array() for _, pose in ordered]).reshape(-1, 3),
    )
