"""``amr-slam watch``."""

from __future__ import annotations

import argparse
from typing import Final

from amr_slam.publishing import PublishingError
from amr_slam.watching import watch
from amr_slam.wire import DEFAULT_ENDPOINT

FAILURES: Final[dict[type[Exception], int]] = {PublishingError: 1}


def run(arguments: argparse.Namespace) -> int:
    """Watch until Ctrl-C."""
    watch(arguments.connect or DEFAULT_ENDPOINT, arguments.robots, keys=arguments.keys)
    return 0
