"""``amr-slam doctor``."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Iterator
from typing import Final

from amr_slam.config import ConfigError, load
from amr_slam.service.doctor.findings import Finding
from amr_slam.wire import DEFAULT_ENDPOINT

FAILURES: Final[dict[type[Exception], int]] = {}


def run(arguments: argparse.Namespace) -> int:
    """Examine the robot here, or one elsewhere; what is found is all that is printed.

    0: all is well; 1: findings.
    """
    logging.disable(logging.WARNING)
    well = True
    try:
        for finding in _found(arguments):
            well &= finding.is_well
            sys.stdout.write(finding.lines())
            sys.stdout.flush()  # devices take their time
    finally:
        logging.disable(logging.NOTSET)
    return 0 if well else 1


def _found(arguments: argparse.Namespace) -> Iterator[Finding]:
    config = None
    try:
        if arguments.config is not None:
            config = load(arguments.config)
    except ConfigError as error:
        do = "correct this key (config/default.toml tells what each means), then run this again"
        yield Finding(part="configuration", what=str(error), do=do)
        return
    # Not above: what is wrong in a configuration is said at once.
    from amr_slam.service.doctor.examining import examine_config, examine_robot  # noqa: PLC0415

    if config is not None:
        yield from examine_config(config, arguments.config)
    else:
        endpoint = arguments.connect or DEFAULT_ENDPOINT
        yield from examine_robot(arguments.robot, endpoint, arguments.keys)
