"""``amr-slam map merge``."""

from __future__ import annotations

import argparse
import math
import sys

from amr_slam.cli.outputs import check_outputs
from amr_slam.cli.progress import Steps
from amr_slam.geometry import Pose2
from amr_slam.map import MapError, load_map, save_map
from amr_slam.merging import Found, MergeError, MergeParams, Merger, find, join
from amr_slam.params import SlamParams


def merge(arguments: argparse.Namespace) -> int:
    """Find one map in the other, say what that is worth, and save both as one."""
    for source in (arguments.map, arguments.other):
        check_outputs(arguments.out, source=source)
    known, _ = load_map(arguments.map)
    other, other_id = load_map(arguments.other)
    params = SlamParams()
    with Steps("merge") as steps:
        try:
            found = find(known, other, params, MergeParams(), _near(arguments), steps.say)
        except MergeError as error:
            raise MapError(f"{arguments.other}, {arguments.map}: {error}") from error
        steps.say("making one map of two", None)
        merger = join(known, other, other_id, found, params)
    merger.map.name = arguments.name or arguments.out.stem
    sys.stdout.write(_told(found, merger))
    new_id = save_map(merger.map, arguments.out)
    scans, area_m2 = len(merger.map.path), merger.map.area_m2()
    sys.stdout.write(f"{arguments.out}: {scans} scans, {area_m2:.1f} m2 of floor; map {new_id}\n")
    return 0


def _near(arguments: argparse.Namespace) -> Pose2 | None:
    if arguments.near is None:
        return None
    x_m, y_m, theta_deg = arguments.near
    return Pose2(x_m, y_m, math.radians(theta_deg))


def _told(found: Found, merger: Merger) -> str:
    pose, overlay = found.known_from_other, found.overlay
    theta_deg = math.degrees(pose.theta_rad)
    rival = "no other place" if found.rival is None else f"next best place {found.rival[1]:.0%}"
    facts = {
        "lies at": f"x {pose.x_m:+.3f} m, y {pose.y_m:+.3f} m, theta {theta_deg:+.3f} deg in the "
        "first map",
        "in common": f"{overlay.common_m2:.1f} m2 of floor; {overlay.fits:.0%} of what both should "
        f"have is in both, {overlay.contradicts:.1%} contradicts",
        "witnesses": f"{found.witnesses} of {found.sought} scans, each found there on its own; "
        f"{rival}",
        "left": f"{overlay.rms_m:.3f} m rms between scans and the rigid motion; bent by "
        f"{merger.bent_m:.3f} m at most",
    }
    lines = [f"{name:12}{fact}" for name, fact in facts.items()]
    for change in merger.changes:
        x_m, y_m = change.centre_m
        lines.append(f"{change.kind:12}at x {x_m:.2f}, y {y_m:.2f}, by the second map")
    return "\n".join(lines) + "\n"
