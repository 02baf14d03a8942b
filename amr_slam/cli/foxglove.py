"""``amr-slam foxglove``."""

from __future__ import annotations

import argparse
import sys
from typing import Final

from amr_slam.cli.outputs import UsageError
from amr_slam.client import SessionError
from amr_slam.wire import DEFAULT_ENDPOINT

FAILURES: Final[dict[type[Exception], int]] = {SessionError: 1, UsageError: 2}


def run(arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    try:
        from amr_slam.watching.foxglove_live import serve  # noqa: PLC0415 - an extra
    except ModuleNotFoundError as error:
        if error.name != "foxglove":
            raise
        raise UsageError(
            "foxglove-sdk is not installed: pip install 'foxglove-sdk>=0.30,<1'"
        ) from error
    serve(
        arguments.connect or DEFAULT_ENDPOINT,
        arguments.robots,
        prefix=arguments.prefix,
        keys=arguments.keys,
        port=arguments.port,
        on_ready=lambda port: sys.stdout.write(f"ws://localhost:{port}\n") and sys.stdout.flush(),
    )
    return 0
