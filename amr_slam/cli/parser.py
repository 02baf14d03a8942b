"""The commands' arguments. Standard library only, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final, NoReturn

MODULES: Final = {
    "run": "amr_slam.cli.daemon",
    "check": "amr_slam.cli.daemon",
    "doctor": "amr_slam.cli.doctor",
    "replay": "amr_slam.cli.replaying",
    "localize": "amr_slam.cli.localizing",
    "map": "amr_slam.cli.maps",
    "watch": "amr_slam.cli.fleet",
    "call": "amr_slam.cli.fleet",
    "keys": "amr_slam.cli.keys",
}
"""Where a command is done: a module with ``run(arguments) -> status`` and ``FAILURES``, the
exceptions that end it with one line, each with its exit status."""

_LISTS: Final = frozenset({"--lidar", "--marker", "--near", "--origin"})
"""Options whose values are numbers joined by commas."""
LOG_HELP: Final = "native recording (.mcap) or CARMEN log (.log, .clf, .gz of these)"


class _Parser(argparse.ArgumentParser):
    """Refuses arguments in one line."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"amr-slam: error: {message} (see {self.prog} --help)\n")
        sys.exit(2)


Subparsers = argparse._SubParsersAction  # noqa: SLF001 - argparse has no public name for it


def make_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    parser = _Parser(
        prog="amr-slam",
        description="Localization for mobile robots from safety laser scanners and wheels.",
        epilog="example: amr-slam replay run.mcap --config robot.toml --map-out hall.amrmap",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"amr-slam {version('amr-slam')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_daemon(commands)
    _add_doctor(commands)
    _add_replay(commands)
    _add_localize(commands)
    _add_map(commands)
    _add_watch(commands)
    _add_call(commands)
    _add_keys(commands)
    return parser


def join_negative_values(argv: Sequence[str]) -> list[str]:
    """``--lidar -0.2,0,180`` as ``--lidar=-0.2,0,180``: argparse takes the former for options."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] in _LISTS and argument[:1] == "-" and "," in argument:
            joined[-1] = f"{joined[-1]}={argument}"
        else:
            joined.append(argument)
    return joined


def _command(
    commands: Subparsers[_Parser], name: str, summary: str, example: str, details: str = ""
) -> _Parser:
    return commands.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}. {details}".rstrip(),
        epilog=f"example: {example}",
        allow_abbrev=False,
    )


def _add_daemon(commands: Subparsers[_Parser]) -> None:
    run = _command(
        commands,
        "run",
        "the daemon, in the foreground, as systemd starts it",
        "amr-slam run --config /etc/amr-slam/amr7.toml",
        "SIGUSR1 saves the last minutes: all bytes of all devices, what was decoded and published "
        "(section recording of the configuration).",
    )
    run.add_argument(
        "--record",
        metavar="FILE.mcap",
        type=_path_ending(".mcap"),
        help="all of that from now on, until the disk is nearly full",
    )
    check = _command(
        commands,
        "check",
        "validates a configuration",
        "amr-slam check --config amr7.toml --probe",
        "Says what is wrong with it in one line, by file and key.",
    )
    for parser in (run, check):
        parser.add_argument("--config", metavar="FILE", type=Path, required=True, help="TOML")
    check.add_argument(
        "--probe", action="store_true", help="open every device and say what it sees"
    )


def _add_doctor(commands: Subparsers[_Parser]) -> None:
    doctor = _command(
        commands,
        "doctor",
        "says what is wrong and what to do next",
        "amr-slam doctor --config /etc/amr-slam/amr7.toml",
        "With --config: this computer, all devices, the map and the routers; a robot that runs "
        "here is asked, else its devices are opened for 5 s. With ROBOT: a robot that runs "
        "elsewhere. Status 1 when something is wrong.",
    )
    which = doctor.add_mutually_exclusive_group(required=True)
    which.add_argument("--config", metavar="FILE", type=Path, help="TOML")
    which.add_argument("robot", metavar="ROBOT", nargs="?", help="its name on Zenoh")
    _add_session(doctor)


def _add_replay(commands: Subparsers[_Parser]) -> None:
    replay = _command(
        commands,
        "replay",
        "the whole pipeline on a recording, as fast as it goes",
        "amr-slam replay intel.log.gz --scan-period 2.0 --lidar 0,0,0 --out intel.tum "
        "--map-out intel.amrmap",
        "Deterministic: the same input gives the same bytes in every file that it writes.",
    )
    _add_log_and_robot(replay)
    add = replay.add_argument
    add(
        "--as-recorded",
        action="store_true",
        help="do again what the daemon did with a recording of its own, and compare the poses with "
        "those it published: status 1 unless all are the same, bit for bit",
    )
    add("--map", metavar="MAP", type=Path, help="localize in this map")
    add(
        "--mapping",
        action=argparse.BooleanOptionalAction,
        help="let the map grow (default: only without --map; with it: go on with that map)",
    )
    add("--map-out", metavar="MAP", type=_path_ending(".amrmap"), help="save the grown map")
    add(
        "--keep",
        metavar="N",
        type=_count,
        default=2,
        help="older versions of --map-out to keep beside it (default 2)",
    )
    add(
        "--out",
        metavar="FILE.tum",
        type=Path,
        help="fused pose at every wheel sample, from nothing but what was known then",
    )
    add(
        "--out-final",
        metavar="FILE.tum",
        type=Path,
        help="the same stamps with each correction spread over the way between the scans",
    )
    add("--report", metavar="FILE.json", type=Path, help="counts, errors, and every scan's answer")


def _add_localize(commands: Subparsers[_Parser]) -> None:
    localize = _command(
        commands,
        "localize",
        "each scan of a log on its own in a map: one JSON object a line",
        "amr-slam localize --map hall.amrmap run.mcap --lidar 0.2,0,0",
        "Fields: stamp (s), accepted (whether the pose may be used), x, y, theta (m, rad; the best "
        "guess even where it is not accepted, null where there is none), covariance[9] and "
        "error95_m (null where not accepted), score (mean fit of the points, 1 = all on walls), "
        "ambiguity (score of the second best place / score of the best, 0 to 1; 1 where nothing "
        "fits), second {x, y, theta, score} or null, reason (why not accepted) or null, elapsed_s.",
    )
    localize.add_argument("--map", metavar="MAP", type=Path, required=True, help="where to look")
    _add_log_and_robot(localize)
    localize.add_argument(
        "--prior",
        choices=("none", "previous"),
        default="none",
        help="previous: begin near the last accepted pose (default none: anywhere in the map)",
    )


def _add_log_and_robot(parser: _Parser) -> None:
    add = parser.add_argument
    add("log", metavar="LOG", type=Path, help=LOG_HELP)
    parameters = parser.add_mutually_exclusive_group()
    parameters.add_argument(
        "--config", metavar="FILE", type=Path, help="the robot's TOML: drive, scanners, parameters"
    )
    parameters.add_argument(
        "--preset", choices=("default", "paper"), default="default", help="parameters without one"
    )
    add(
        "--scan-period",
        metavar="S",
        type=_seconds,
        default=0.0,
        help="at most one scan of each scanner in so many seconds (default 0: every scan)",
    )
    add(
        "--lidar",
        metavar="X,Y,THETA_DEG",
        type=_mounting,
        help="where every scanner of the log sits on the robot, in m and degrees",
    )


def _add_map(commands: Subparsers[_Parser]) -> None:
    parser = _command(commands, "map", "what is in a map", "amr-slam map info hall.amrmap")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    info = _command(
        actions, "info", "its identity and size", "amr-slam map info hall.amrmap --json"
    )
    info.add_argument("--json", action="store_true", help="as one JSON object")
    render = _command(
        actions,
        "render",
        "a picture of it",
        "amr-slam map render hall.amrmap --out hall.png",
        "Walls, the floor that was seen, and the path of the scans that it is made of.",
    )
    render.add_argument(
        "--out", metavar="FILE", type=_path_ending(".png", ".svg"), required=True, help="PNG or SVG"
    )
    export = _command(
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
        type=_path_ending(".pgm", ".csv", ".ply", ".tum"),
        required=True,
        help="what to write",
    )
    align = _add_align(actions)
    for action in (info, render, export, align):
        action.add_argument("map", metavar="MAP", type=Path, help="NAME.amrmap")


def _add_align(actions: Subparsers[_Parser]) -> _Parser:
    align = _command(
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
        type=_finite,
        help="this added to the camera's stamps is the map's (default: estimated)",
    )
    add(
        "--marker",
        metavar="X,Y,THETA_DEG",
        type=_mounting,
        help="where the cameras' marker sits on the robot (default: estimated)",
    )
    add("--resolution", metavar="M", type=_seconds, help="side of a pixel of the floor plan")
    add(
        "--origin",
        metavar="X,Y[,THETA_DEG]",
        type=_corner,
        help="the plan's lower left corner in the site's frame (default 0,0)",
    )
    add(
        "--near",
        metavar="X,Y,THETA_DEG",
        type=_mounting,
        help="the map's origin in the plan, to 5 m and 45 deg, where it fits in several ways",
    )
    add(
        "--max-rms",
        metavar="M",
        type=_seconds,
        default=0.05,
        help="refuse what leaves more than this between both (default 0.05)",
    )
    add("--out", metavar="NEW.amrmap", type=_path_ending(".amrmap"), required=True)
    add("--name", help="the new map's name (default: the file's)")
    add(
        "--picture",
        metavar="FILE",
        type=_path_ending(".png", ".svg"),
        help="map and residuals, or the plan",
    )
    add("--residuals", metavar="FILE.csv", type=_path_ending(".csv"), help="what each pair leaves")
    return align


def _add_watch(commands: Subparsers[_Parser]) -> None:
    watch = _command(
        commands,
        "watch",
        "live table of the robots on Zenoh, until Ctrl-C",
        "amr-slam watch --connect tcp/192.168.1.20:7447 amr7",
        "Red is not to be driven by: a robot whose poses stop is stale after half a second. One "
        "line a second and robot where standard output is no terminal.",
    )
    _add_session(watch)
    watch.add_argument(
        "--sort",
        choices=("name", "state", "error", "age"),
        default="name",
        help="by name (default), or with what needs a look first",
    )
    watch.add_argument("--once", action="store_true", help="show what there is, and end")
    watch.add_argument("--json", action="store_true", help="lines of JSON: all that is known")
    watch.add_argument("robots", metavar="ROBOT", nargs="*", help="only these (default: all)")


def _add_call(commands: Subparsers[_Parser]) -> None:
    call = _command(
        commands,
        "call",
        "sends a command to a robot and prints the reply",
        """amr-slam call amr7 set_pose '{"x": 1.5, "y": 2.0, "theta": 0.0, "radius": 3.0}'""",
        "Commands: set_pose {x, y, theta, radius} (m, rad; searched), resume_pose {x, y, theta} "
        "(taken as is), relocalize, start_mapping {name}, save_map {name}, load_map {name}, "
        "save_recording {reason}. Status 1 when the robot refuses or does not answer.",
    )
    _add_session(call)
    call.add_argument(
        "--timeout",
        metavar="S",
        type=_seconds,
        default=10.0,
        help="how long to wait for the reply (default 10)",
    )
    call.add_argument("robot", metavar="ROBOT")
    call.add_argument("what", metavar="COMMAND")
    call.add_argument("arguments", metavar="JSON", nargs="?", default="{}", help="default {}")


def _add_session(parser: _Parser) -> None:
    parser.add_argument(
        "--connect",
        metavar="ENDPOINT",
        help="a robot's or router's Zenoh endpoint (default: this computer)",
    )
    parser.add_argument(
        "--keys", metavar="FOLDER", type=Path, help="what 'amr-slam keys fleet NAME' wrote"
    )
    parser.add_argument(
        "--prefix", default="amr", help="first part of the robots' keys (default amr)"
    )


def _add_keys(commands: Subparsers[_Parser]) -> None:
    keys = _command(
        commands,
        "keys",
        "keys and access rules of a site: its router, robots and controllers",
        "amr-slam keys init --site hall3 --router 192.168.1.5",
    )
    actions = keys.add_subparsers(dest="action", metavar="ACTION", required=True)
    init = _command(
        actions,
        "init",
        "a new site",
        "amr-slam keys init --site hall3 --router 192.168.1.5",
    )
    init.add_argument("--site", metavar="NAME", required=True, help="what certificates call it")
    init.add_argument(
        "--router",
        metavar="HOST",
        nargs="+",
        required=True,
        help="names or addresses under which robots find the router",
    )
    init.add_argument("--prefix", default="amr", help="first part of all keys (default amr)")
    init.add_argument(
        "--auth",
        choices=("tls", "password"),
        default="tls",
        help="certificates on both sides, encrypted (default), or user and password in the clear",
    )
    robot = _command(
        actions,
        "robot",
        "keys for a robot: it may publish its own keys, nothing else",
        "amr-slam keys robot amr7",
    )
    fleet = _command(
        actions,
        "fleet",
        "keys for a controller: it may look, and with --commands command",
        "amr-slam keys fleet controller --commands",
    )
    fleet.add_argument("--commands", action="store_true", help="it may call commands")
    revoke = _command(
        actions,
        "revoke",
        "a member's keys open nothing any more",
        "amr-slam keys revoke robot amr7",
    )
    revoke.add_argument("kind", choices=("robot", "fleet"))
    for parser in (robot, fleet, revoke):
        parser.add_argument("name", metavar="NAME")
    ros2 = _command(
        actions,
        "ros2",
        "robots may also speak ROS 2, each in the namespace of its name; those who may command may "
        "also send initial poses",
        "amr-slam keys ros2 0",
    )
    ros2.add_argument(
        "domain", metavar="DOMAIN|off", type=_domain, help="ROS_DOMAIN_ID, 0 to 232, or off"
    )
    vda5050 = _command(
        actions,
        "vda5050",
        "robots may also speak VDA 5050, each under its name as serial number; those who may "
        "command may also send instant actions",
        "amr-slam keys vda5050 uagv",
    )
    vda5050.add_argument(
        "interface",
        metavar="INTERFACE|off",
        type=lambda text: None if text == "off" else text,
        help="first level of the topics, or off",
    )
    listed = _command(actions, "list", "members and when their keys expire", "amr-slam keys list")
    for parser in (init, robot, fleet, revoke, ros2, vda5050, listed):
        parser.add_argument(
            "--dir", type=Path, default=Path("keys"), help="the site's folder (default keys)"
        )
    for parser in (init, robot, fleet):
        parser.add_argument(
            "--days", type=_days, default=730, help="certificates are valid for (default 730)"
        )


# -- values ----------------------------------------------------------------------------------


def _seconds(text: str) -> float:
    return _finite(text, least=0.0)


def _finite(text: str, least: float = -math.inf) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number >= least):
        bound = "" if least == -math.inf else f" of at least {least:g}"
        raise argparse.ArgumentTypeError(f"{text!r} is not a number{bound}")
    return number


def _count(text: str) -> int:
    if not (text.isdecimal() and len(text) <= 3):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to 999")
    return int(text)


def _days(text: str) -> int:
    if not (text.isdecimal() and len(text) <= 4 and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of days from 1 to 9999")
    return int(text)


def _domain(text: str) -> int | None:
    if text == "off":
        return None
    if not (text.isdecimal() and len(text) <= 3 and int(text) <= 232):
        raise argparse.ArgumentTypeError(f"{text!r} is not a ROS_DOMAIN_ID from 0 to 232, or off")
    return int(text)


def _mounting(text: str) -> tuple[float, float, float]:
    """x m, y m, theta degrees."""
    fields = text.split(",")
    if len(fields) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not X,Y,THETA_DEG")
    x_m, y_m, theta_deg = (_finite(field) for field in fields)
    return x_m, y_m, theta_deg


def _corner(text: str) -> tuple[float, float, float]:
    """x m, y m, and theta in degrees where it is not 0."""
    return _mounting(text if text.count(",") == 2 else f"{text},0")


def _path_ending(*endings: str) -> Callable[[str], Path]:
    def path(text: str) -> Path:
        if Path(text).suffix not in endings:
            raise argparse.ArgumentTypeError(f"{text!r} does not end in {' or '.join(endings)}")
        return Path(text)

    return path
