"""``amr-slam view``."""

from __future__ import annotations

import argparse
import sys
from typing import Final

from amr_slam.viewing import ViewError, ViewSettings, view
from amr_slam.wire import DEFAULT_ENDPOINT

FAILURES: Final[dict[type[Exception], int]] = {ViewError: 2}


def run(arguments: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    settings = ViewSettings(
        endpoint=arguments.connect or DEFAULT_ENDPOINT,
        robots=tuple(arguments.robots),
        prefix=arguments.prefix,
        keys=arguments.keys,
        full_rate=arguments.full_rate,
        host=arguments.host,
        port=arguments.port,
        allow_commands=arguments.allow_commands,
        tokens=arguments.tokens,
        certificate=arguments.cert,
        key=arguments.key,
    )
    view(settings, _ready)
    return 0


def _ready(address: str) -> None:
    sys.stdout.write(f"{address}\n")
    sys.stdout.flush()
