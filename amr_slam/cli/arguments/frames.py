"""``amr-slam map align`` and ``map merge``: what brings a map into another frame."""

from __future__ import annotations

from pathlib import Path

from amr_slam.cli.arguments.base import Parser, Subparsers, add_command
from amr_slam.cli.arguments.values import corner, finite, mounting, path_ending, seconds


def add_align(actions: Subparsers[Parser]) -> Parser:
    """The command; MAP is added to it by who adds it to all."""
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


def add_merge(actions: Subparsers[Parser]) -> Parser:
    """The command, but for its maps."""
    merge = add_command(
        actions,
        "merge",
        "two maps of one hall, made in sessions of their own, into a new one",
        "amr-slam map merge hall-east.amrmap hall-west.amrmap --out hall.amrmap",
        "Finds where the second lies in the first by what both have seen, and refuses where that "
        "is not told for sure. The first one's frame stays; what the second contradicts gives "
        "way. docs/maps.md.",
    )
    add = merge.add_argument
    add("--out", "-o", metavar="NEW.amrmap", type=path_ending(".amrmap"), required=True)
    add("--name", help="the new map's name (default: the file's)")
    add(
        "--near",
        metavar="X,Y,THETA_DEG",
        type=mounting,
        help="the second map's origin in the first, to 5 m and 45 deg, where they fit in several "
        "ways (0,0,0: one frame already)",
    )
    return merge
