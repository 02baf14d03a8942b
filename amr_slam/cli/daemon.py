"""``amr-slam run`` and ``amr-slam check``."""

from __future__ import annotations

import argparse
from typing import Final

from amr_slam.cli.outputs import UsageError, check_outputs
from amr_slam.config import ConfigError, load

FAILURES: Final[dict[type[Exception], int]] = {UsageError: 2, ConfigError: 2}


def run(arguments: argparse.Namespace) -> int:
    """Hand over to the service, once the configuration is known to be right: what is wrong in it is
    to be said within a second, and the service's imports take a part of that."""
    config = load(arguments.config)
    if arguments.command == "check":
        from amr_slam.service.probe import check  # noqa: PLC0415

        return check(config, arguments.config, probe=arguments.probe)
    check_outputs(arguments.record, source=arguments.config)
    from amr_slam.client import SessionError  # noqa: PLC0415
    from amr_slam.service import daemon  # noqa: PLC0415

    FAILURES[SessionError] = 1  # known from here on only: its module imports zenoh
    return daemon.run(config, arguments.config, arguments.record, arguments.started)
