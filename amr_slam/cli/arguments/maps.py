"""``amr-slam map ...``"""

from __future__ import annotations

from pathlib import Path

from amr_slam.cli.arguments.base import Parser, Subparsers, add_command
from amr_slam.cli.arguments.values import (
    corner,
    count,
    finite,
    mounting,
    path_ending,
    poses,
    seconds,
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
        "wall points with normals; .tum: the path of the scans that it is made of.",
    )
    export.add_argument(
        "--out",
        metavar="FILE",
        type=path_ending(".pgm", ".csv", ".ply", ".tum"),
        required=True,
        help="what to write",
    )
    align, report = _add_align(actions), _add_report(actions)
    for action in (info, render, export, align, report):
        action.add_argument("map", metavar="MAP", type=Path, help="NAME.amrmap")


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


def _add_align(actions: Subparsers[Parser]) -> Parser:
    align = add_command(
        actions,
        "align",
        "into the frame that people know: of ceiling cameras, a survey, a floor plan",
        "amr-slam map align hall.amrmap --camera cameras.csv --slam drive.tum --out site.amrmap",
        "The map is shifted and turned, never stretched, and saved as a new one. Status 1, and no "
        "map, where the two do not fit or the transform is not told. Tables: docs/cameras.md.",
    )
    add = align.add_argument
    by = align.add_mutually_exclusive_group(required=True)
    by.add_argument(
        "--pairs",
        metavar="FILE.csv",
        type=Path,
        help="poses in both: camera_x,camera_y,slam_x,slam_y and more; shadow mode records them",
    )
    by.add_argument(
        "--camera",
        metavar="FILE",
        type=Path,
        help="trajectory of the cameras: CSV with stamp,x,y[,theta] or TUM; needs --slam",
    )
    by.add_argument(
        "--landmarks",
        metavar="FILE.csv",
        type=Path,
        help="points that both know: name,x_map,y_map,x_site,y_site",
    )
    by.add_argument(
        "--floor-plan",
        metavar="FILE",
        type=Path,
        help="picture with dark walls, or YAML of nav2's map server",
    )
    add("--slam", metavar="FILE.tum", type=Path, help="the same drive by 'replay --map --out'")
    add(
        "--clock",
        metavar="S",
        type=finite,
        help="this added to the camera's stamps is the map's (default: estimated)",
    )
    add(
        "--marker",
        metavar="X,Y,THETA_DEG",
        type=mounting,
        help="where the cameras' marker sits on the robot (default: estimated)",
    )
    add("--resolution", metavar="M", type=seconds, help="side of a pixel of the floor plan")
    add(
        "--origin",
        metavar="X,Y[,THETA_DEG]",
        type=corner,
        help="the plan's lower left corner in the site's frame (default 0,0)",
    )
    add(
        "--near",
        metavar="X,Y,THETA_DEG",
        type=mounting,
        help="the map's origin in the plan, to 5 m and 45 deg, where it fits in several ways",
    )
    add(
        "--max-rms",
        metavar="M",
        type=seconds,
        default=0.05,
        help="refuse what leaves more than this between both (default 0.05)",
    )
    add("--out", metavar="NEW.amrmap", type=path_ending(".amrmap"), required=True)
    add("--name", help="the new map's name (default: the file's)")
    add(
        "--picture",
        metavar="FILE",
        type=path_ending(".png", ".svg"),
        help="map and residuals, or the plan",
    )
    add("--residuals", metavar="FILE.csv", type=path_ending(".csv"), help="what each pair leaves")
    return align
