"""Commands that run, look at and replay one robot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from amr_slam.cli.arguments.base import Parser, Subparsers, add_command, add_session
from amr_slam.cli.arguments.values import count, mounting, path_ending, seconds

LOG_HELP: Final = "native recording (.mcap) or CARMEN log (.log, .clf, .gz of these)"


def add_daemon(commands: Subparsers[Parser]) -> None:
    """``amr-slam run`` and ``check``."""
    run = add_command(
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
        type=path_ending(".mcap"),
        help="all of that from now on, until the disk is nearly full",
    )
    check = add_command(
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


def add_doctor(commands: Subparsers[Parser]) -> None:
    """``amr-slam doctor``."""
    doctor = add_command(
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
    add_session(doctor)


def add_replay(commands: Subparsers[Parser]) -> None:
    """``amr-slam replay``."""
    replay = add_command(
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
    add(
        "--hold",
        action="store_true",
        help="with --map and --mapping: what is in the map stays as it is, what is new joins it",
    )
    add("--map-out", metavar="MAP", type=path_ending(".amrmap"), help="save the grown map")
    add("--no-loops", action="store_true", help="close no loops of a new map: to see what they do")
    add(
        "--keep",
        metavar="N",
        type=count,
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


def add_localize(commands: Subparsers[Parser]) -> None:
    """``amr-slam localize``."""
    localize = add_command(
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


def _add_log_and_robot(parser: Parser) -> None:
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
        type=seconds,
        default=0.0,
        help="at most one scan of each scanner in so many seconds (default 0: every scan)",
    )
    add(
        "--lidar",
        metavar="X,Y,THETA_DEG",
        type=mounting,
        help="where every scanner of the log sits on the robot, in m and degrees",
    )
