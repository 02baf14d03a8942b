"""``amr-slam run`` and ``amr-slam check``."""

from __future__ import annotations

import argparse
from typing import Final

from amr_slam import service
from amr_slam.cli.outputs import UsageError, check_outputs
from amr_slam.client import SessionError
from amr_slam.config import ConfigError

FAILURES: Final[dict[type[Exception], int]] = {
    UsageError: 2,
    ConfigError: 2,
    SessionError: 1,
}


def run(arguments: argparse.Namespace) -> int:
    """Hand over to the service."""
    if arguments.command == "check":
        return service.check(arguments.config, probe=arguments.probe)
    check_outputs(arguments.record, source=arguments.config)
    return service.run(arguments.config, arguments.record, arguments.started)
