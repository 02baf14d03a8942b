"""``amr-slam ...``: the one place that maps errors to messages and exit status.

0 success, 1 a failed operation, 2 bad arguments or configuration, 130 Ctrl-C. Results go to
standard output or to the named files, the log and errors to standard error.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from amr_slam.cli import logs
from amr_slam.cli.arguments import MODULES, join_negative_values, make_parser
from amr_slam.starting import started


def main(argv: Sequence[str] | None = None) -> int:
    """Parse the arguments, do what they say, and return the exit status."""
    arguments = make_parser().parse_args(
        join_negative_values(sys.argv[1:] if argv is None else argv)
    )
    logs.set_up()
    try:
        if arguments.command == "run":
            # The two processes import side by side.
            with started() as arguments.started:
                return _run(arguments)
        return _run(arguments)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # Who read our output has seen enough; what is still buffered must not raise at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _run(arguments: argparse.Namespace) -> int:
    # Imported here, not above: --help and refused arguments need none of it.
    command = importlib.import_module(MODULES[arguments.command])
    try:
        status: int = command.run(arguments)
        sys.stdout.flush()
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            return _refuse(f"{error.filename}: {error.strerror}", 1)
        for kind, exit_status in command.FAILURES.items():
            if isinstance(error, kind):
                return _refuse(str(error), exit_status)
        raise
    return status


def _refuse(message: str, status: int) -> int:
    """One line, whatever names and values are in it."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(message.split()))
    sys.stderr.write(f"amr-slam: error: {line}\n")
    return status
