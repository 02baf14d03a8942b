"""The commands' arguments. Standard library only, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from importlib.metadata import version
from typing import Final

from amr_slam.cli.arguments.base import Parser
from amr_slam.cli.arguments.fleet import add_call, add_foxglove, add_keys, add_watch
from amr_slam.cli.arguments.maps import add_map
from amr_slam.cli.arguments.robots import add_daemon, add_doctor, add_localize, add_replay

MODULES: Final = {
    "run": "amr_slam.cli.daemon",
    "check": "amr_slam.cli.daemon",
    "doctor": "amr_slam.cli.doctor",
    "replay": "amr_slam.cli.replaying",
    "localize": "amr_slam.cli.localizing",
    "map": "amr_slam.cli.maps",
    "watch": "amr_slam.cli.fleet",
    "foxglove": "amr_slam.cli.foxglove",
    "call": "amr_slam.cli.fleet",
    "keys": "amr_slam.cli.keys",
}
"""Where a command is done: a module with ``run(arguments) -> status`` and ``FAILURES``, the
exceptions that end it with one line, each with its exit status."""

_LISTS: Final = frozenset({"--lidar", "--marker", "--near", "--origin"})
"""Options whose values are numbers joined by commas."""


def make_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    parser = Parser(
        prog="amr-slam",
        description="Localization for mobile robots from safety laser scanners and wheels.",
        epilog="example: amr-slam replay run.mcap --config robot.toml --map-out hall.amrmap",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"amr-slam {version('amr-slam')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    add_daemon(commands)
    add_doctor(commands)
    add_replay(commands)
    add_localize(commands)
    add_map(commands)
    add_watch(commands)
    add_foxglove(commands)
    add_call(commands)
    add_keys(commands)
    return parser


def join_negative_values(argv: Sequence[str]) -> list[str]:
    """``--lidar -0.2,0,180`` as ``--lidar=-0.2,0,180``, and a point ``-1,2`` with a blank before
    it: argparse takes both for options."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] in _LISTS and argument[:1] == "-" and "," in argument:
            joined[-1] = f"{joined[-1]}={argument}"
        elif re.fullmatch(r"-[\d.]+(e-?\d+)?,.*", argument):
            joined.append(f" {argument}")
        else:
            joined.append(argument)
    return joined
