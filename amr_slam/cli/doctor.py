"""``amr-slam doctor``."""

from __future__ import annotations

import argparse
import logging
from typing import Final

from amr_slam.service.doctor import examine_config, examine_robot
from amr_slam.wire import DEFAULT_ENDPOINT

FAILURES: Final[dict[type[Exception], int]] = {}


def run(arguments: argparse.Namespace) -> int:
    """Examine the robot here, or one elsewhere; what is found is all that is printed."""
    logging.disable(logging.WARNING)
    try:
        if arguments.config is not None:
            return examine_config(arguments.config)
        endpoint = arguments.connect or DEFAULT_ENDPOINT
        return examine_robot(arguments.robot, endpoint, arguments.keys)
    finally:
        logging.disable(logging.NOTSET)
