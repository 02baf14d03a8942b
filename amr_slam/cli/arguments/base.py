"""What all commands' arguments are made with."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """Refuses arguments in one line."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"amr-slam: error: {message} (see {self.prog} --help)\n")
        sys.exit(2)


Subparsers = argparse._SubParsersAction  # noqa: SLF001 - argparse has no public name for it


def add_command(
    commands: Subparsers[Parser], name: str, summary: str, example: str, details: str = ""
) -> Parser:
    """A command with an example in its help."""
    return commands.add_parser(
        name,
        help=summary,
        description=f"{summary[0].upper()}{summary[1:]}. {details}".rstrip(),
        epilog=f"example: {example}",
        allow_abbrev=False,
    )


def add_session(parser: Parser) -> None:
    """How to reach robots on Zenoh."""
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
