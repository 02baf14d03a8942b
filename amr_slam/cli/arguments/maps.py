"""``amr-slam map ...``"""

from __future__ import annotations

from pathlib import Path

from amr_slam.cli.arguments.base import Parser, Subparsers, add_command
from amr_slam.cli.arguments.values import (
    cell,
    corner,
    count,
    finite,
    mounting,
    path_ending,
    point,
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
    align = _add_align(actions)
    _add_edit(actions)
    for action in (info, render, export, align):
        action.add_argument("map", metavar="MAP", type=Path, help="NAME.amrmap")


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
