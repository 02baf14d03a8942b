"""``amr-slam watch`` and ``amr-slam call``."""

from __future__ import annotations

import argparse
import sys
from typing import Final

from amr_slam.cli.outputs import UsageError
from amr_slam.client import AskingError, SessionError, call, close_session, open_client
from amr_slam.watching import watch
from amr_slam.wire import DEFAULT_ENDPOINT, WireError, command_of

FAILURES: Final[dict[type[Exception], int]] = {SessionError: 1, AskingError: 1, UsageError: 2}

_CONNECT_TIMEOUT_S: Final = 5.0


def run(arguments: argparse.Namespace) -> int:
    """Watch until Ctrl-C, or call."""
    endpoint = arguments.connect or DEFAULT_ENDPOINT
    if arguments.command == "call":
        return _call(arguments, endpoint)
    watch(
        endpoint,
        arguments.robots,
        prefix=arguments.prefix,
        keys=arguments.keys,
        sort=arguments.sort,
        form="json" if arguments.json else "text",
        once=arguments.once,
    )
    return 0


def _call(arguments: argparse.Namespace, endpoint: str) -> int:
    try:
        command = command_of(arguments.what, arguments.arguments.encode())
    except WireError as error:  # before anything is sent
        raise UsageError(str(error)) from error
    session = open_client(endpoint, arguments.keys, _CONNECT_TIMEOUT_S)
    try:
        reply = call(session, arguments.prefix, arguments.robot, command, arguments.timeout)
    finally:
        close_session(session)
    sys.stdout.write(reply.encode().decode() + "\n")
    return 0 if reply.ok else 1
