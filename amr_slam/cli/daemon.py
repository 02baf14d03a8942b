"""``amr-slam run`` and ``amr-slam check``."""

from __future__ import annotations

import argparse
from typing import Final

from amr_slam import service
from amr_slam.config import ConfigError
from amr_slam.publishing import PublishingError

FAILURES: Final[dict[type[Exception], int]] = {ConfigError: 2, PublishingError: 1}


def run(arguments: argparse.Namespace) -> int:
    """Hand over to the service."""
    if arguments.command == "check":
        return service.check(arguments.config, probe=arguments.probe)
    return service.run(arguments.config)
