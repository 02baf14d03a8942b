#!/usr/bin/env python3
"""Install AMR-SLAM on a robot's computer: environment, unit, udev rules, CAN interface, example.

Run by the system's Python as root, in the folder of the sources. The same again changes nothing; a
newer version is installed beside the old one and replaces it when all went well. Nothing is started
or restarted: docs/install.md says how. Status 1: it failed, and what is in use is as it was.

Example: sudo python3 tools/install.py
         sudo python3 tools/install.py --rollback
         sudo python3 tools/install.py --uninstall
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

REPO = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(REPO))  # nothing is installed yet

from amr_slam.installation import (  # noqa: E402
    InstallError,
    Machine,
    install,
    roll_back,
    uninstall,
    wheel_of,
)


def main() -> int:
    """Parse, install or uninstall."""
    arguments = _parser().parse_args()
    machine = Machine(root=arguments.root.resolve(), dry=arguments.dry_run, say=print)
    if machine.root == Path("/") and os.geteuid() != 0 and not machine.dry:
        print("install: must be run as root (sudo)", file=sys.stderr)
        return 1
    try:
        if arguments.uninstall or arguments.purge:
            uninstall(machine, purge=arguments.purge)
        elif arguments.rollback:
            roll_back(machine)
        else:
            _install(machine, arguments)
    except (InstallError, OSError) as error:
        print(f"install: {error}", file=sys.stderr)
        return 1
    return 0


def _install(machine: Machine, arguments: argparse.Namespace) -> None:
    house = None if arguments.wheelhouse is None else arguments.wheelhouse.resolve()
    with tempfile.TemporaryDirectory() as folder:
        wheel = arguments.wheel or wheel_of(REPO, Path(folder), house)
        install(machine, wheel.resolve(), REPO / "requirements.lock", house)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--wheel", type=Path, help="install this one; otherwise one is built from the sources")
    add("--wheelhouse", type=Path, help="folder of the packages to install from, without network")
    add("--rollback", action="store_true", help="go back to the version used before")
    add("--uninstall", action="store_true", help="remove it; maps and configuration stay")
    add("--purge", action="store_true", help="remove it with maps, recordings, configuration")
    add("--dry-run", action="store_true", help="say what would be done")
    add("--root", type=Path, default=Path("/"), help="another system's root folder")
    return parser


if __name__ == "__main__":
    sys.exit(main())
