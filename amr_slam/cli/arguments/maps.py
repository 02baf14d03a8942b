"""``amr-slam map ...``"""

from __future__ import annotations

from pathlib import Path

from amr_slam.cli.arguments.base import Parser, Subparsers, add_command
from amr_slam.cli.arguments.frames import add_align, add_merge
from amr_slam.cli.arguments.values import (
    cell,
    count,
    numbers,
    path_ending,
    point,
    poses,
)


def add_map(commands: Subparsers[Parser]) -> None:
    """``amr-slam map``."""
    parser = add_command(commands, "map", "what is in a map", "amr-slam map info hall.amrmap")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    info = add_command(
        actions, "info", "its identity and size", "amr-slam map info hall.amrmap --json"
    )
    info.add_argument("--json", action="store_true", help="as one JSON object")
    render = add_command(
        actions,
        "render",
        "a picture of it",
        "amr-slam map render hall.amrmap --out hall.png",
        "Walls, the floor that was seen, and the path of the scans that it is made of.",
    )
    render.add_argument(
        "--out", metavar="FILE", type=path_ending(".png", ".svg"), required=True, help="PNG or SVG"
    )
    export = add_command(
        actions,
        "export",
        "into other programs' formats, by the file's ending",
        "amr-slam map export hall.amrmap --out hall.pgm",
        ".pgm: occupancy image with its YAML file beside it, for nav2's map server; .csv and .ply: "
        "wall points with normals; .g2o: the pose graph; .tum: the path of the scans that it is "
        "made of. Erased areas and drawn walls are in pictures and points, zones are not told.",
    )
    export.add_argument(
        "--out",
        metavar="FILE",
        type=path_ending(".pgm", ".csv", ".ply", ".g2o", ".tum"),
        required=True,
        help="what to write",
    )
    align, report = add_align(actions), _add_report(actions)
    export.add_argument(
        "--resolution",
        metavar="M",
        type=cell,
        help="side of a pixel of the .pgm (default: of a wall cell)",
    )
    bring = add_command(
        actions,
        "import",
        "a map that another program made",
        "amr-slam map import site.yaml --out site.amrmap",
        "Reads what nav2's map server reads: a YAML file and its picture (PGM, PNG, ...). Walls "
        "are known to half a cell, and poses in such a map never claim to be better.",
    )
    bring.add_argument("map", metavar="FILE.yaml", type=path_ending(".yaml", ".yml"))
    bring.add_argument("--out", metavar="NEW.amrmap", type=path_ending(".amrmap"), required=True)
    bring.add_argument("--name", help="the map's name (default: the file's)")
    _add_edit(actions)
    merge = add_merge(actions)
    for action in (info, render, export, align, report, *_add_living(actions)):
        action.add_argument("map", metavar="MAP", type=Path, help="NAME.amrmap")
    merge.add_argument("map", metavar="MAP", type=Path, help="whose frame is kept")
    merge.add_argument("other", metavar="LATER", type=Path, help="the map that joins it")


def _add_edit(actions: Subparsers[Parser]) -> None:
    edit = add_command(
        actions,
        "edit",
        "layers over it: erased areas, drawn walls, zones without landmarks",
        "amr-slam map edit hall.amrmap erase 4.1,0.2 5.3,0.2 5.3,1.4 4.1,1.4 --name pallets",
        "What scanners saw stays in the file; layers can be removed, and steps undone. Points are "
        "X,Y in m in the map's frame. Daemons use them once they load the map again.",
    )
    edit.add_argument("map", metavar="MAP", type=Path, help="NAME.amrmap")
    steps = edit.add_subparsers(dest="step", metavar="STEP", required=True)
    listed = add_command(steps, "list", "all layers", "amr-slam map edit hall.amrmap list --json")
    listed.add_argument("--json", action="store_true", help="as JSON, which 'draw' reads")
    example = "amr-slam map edit hall.amrmap"
    drawing = [
        ("erase", "nothing is there: a polygon", f"{example} erase 4,0 5,0 5,1 4,1"),
        ("wall", "a wall is there: a polyline", f"{example} wall 0,0 6.5,0 --name partition"),
        ("zone", "don't localize by what is there: a polygon", f"{example} zone -2,0 3,0 3,4 -2,4"),
    ]
    for kind, summary, told in drawing:
        step = _add_step(steps, kind, summary, told)
        step.add_argument("points", metavar="X,Y", type=point, nargs="+", help="in order, in m")
        step.add_argument("--name", help="what messages call it (default: KIND-NUMBER)")
    draw = _add_step(steps, "draw", "layers from a file", f"{example} draw layers.json")
    draw.add_argument("file", metavar="FILE.json", type=Path, help="as 'list --json' writes it")
    remove = _add_step(steps, "remove", "layers, by name or UUID", f"{example} remove pallets")
    remove.add_argument("names", metavar="NAME", nargs="+")
    _add_step(steps, "undo", "the last step", f"{example} undo")


def _add_step(steps: Subparsers[Parser], name: str, summary: str, example: str) -> Parser:
    step = add_command(steps, name, summary, example)
    step.add_argument("--by", metavar="WHO", help="who does it (default: who is logged in)")
    step.add_argument(
        "--out", metavar="NEW.amrmap", type=path_ending(".amrmap"), help="default: MAP itself"
    )
    step.add_argument(
        "--keep",
        metavar="N",
        type=count,
        default=2,
        help="older versions that stay as MAP.1, MAP.2, ... (default 2)",
    )
    return step


def _add_report(actions: Subparsers[Parser]) -> Parser:
    report = add_command(
        actions,
        "report",
        "what it is good for: coverage, accuracy, look-alikes, and what to do about them",
        "amr-slam map report hall.amrmap --config robot.toml --out hall.html",
        "One HTML page that loads nothing from outside; print it for a PDF. The robot's search is "
        "run at many simulated poses: some minutes for a large hall. docs/map-report.md.",
    )
    add = report.add_argument
    add(
        "--config",
        metavar="FILE",
        type=Path,
        help="the robot's TOML: its scanners (default: two of 270 degrees at opposite corners)",
    )
    add(
        "--out",
        metavar="FILE.html",
        type=path_ending(".html"),
        default=Path("report.html"),
        help="the page (default report.html)",
    )
    add("--json", metavar="FILE.json", type=path_ending(".json"), help="the same for programs")
    add(
        "--poses",
        metavar="N",
        type=poses,
        help="cold starts that are tried over the floor, 10 to 5000 (default 240)",
    )
    add("--seed", metavar="N", type=count, default=0, help="of headings and noise (default 0)")
    return report


def _add_living(actions: Subparsers[Parser]) -> tuple[Parser, ...]:
    """What has changed, and what becomes of it."""
    diff = add_command(
        actions,
        "diff",
        "what has changed: as the robot has watched it, or against an older version",
        "amr-slam map diff hall.amrmap --out hall-changes.png",
        "A list: what is new or gone, where, since when, and how many passes in a row have shown "
        "it. docs/living-maps.md.",
    )
    diff.add_argument("--json", action="store_true", help="as one JSON object")
    diff.add_argument(
        "--out", metavar="FILE", type=path_ending(".png", ".svg"), help="a picture of it"
    )
    accept = add_command(
        actions,
        "accept",
        "take watched changes into the map, as a new version of it",
        "amr-slam map accept hall.amrmap --only 1,3",
        "The version before stays as MAP.1: 'map rollback' brings it back. The robot takes the new "
        "one up by its command load_map, without losing its pose.",
    )
    which = accept.add_mutually_exclusive_group(required=True)
    which.add_argument("--all", action="store_true", help="all that 'map diff' lists")
    which.add_argument(
        "--only", metavar="N,N,...", type=numbers, help="these, by their numbers in 'map diff'"
    )
    which.add_argument(
        "--policy", metavar="FILE", type=Path, help="what this configuration's [map.accept] says"
    )
    accept.add_argument(
        "--keep",
        metavar="N",
        type=count,
        default=9,
        help="older versions to keep beside it, 9 at most (default 9)",
    )
    rollback = add_command(
        actions,
        "rollback",
        "an older version becomes the map again",
        "amr-slam map rollback hall.amrmap",
        "What it replaces becomes version 1: nothing is lost.",
    )
    rollback.add_argument(
        "--to", metavar="N", type=count, default=1, help="version MAP.N (default 1, the newest)"
    )
    # MAP comes first; what to compare it with is added after it.
    diff.add_argument("map", metavar="MAP", type=Path, help="NAME.amrmap")
    diff.add_argument(
        "against",
        metavar="OLDER|CHANGES",
        type=Path,
        nargs="?",
        help="an older map, or a file of changes (default: MAP.changes)",
    )
    return accept, rollback
