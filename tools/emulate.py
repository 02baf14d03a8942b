"""Be all devices of a configuration: a simulated robot drives a simulated laboratory before them.

Serial ports become links to pseudo-terminals, addresses must be this machine's. Ends with Ctrl-C.

Example: python tools/emulate.py config/sick_tim.toml     and beside it
         amr-slam check --config config/sick_tim.toml --probe
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from amr_drivers.emulators import standing_in
from amr_drivers.emulators.surroundings import Surroundings
from amr_slam.config import Config, ConfigError, load


def main() -> int:
    """Parse, open all devices, drive until told to stop."""
    arguments = _parser().parse_args()
    try:
        with ExitStack() as opened:
            surroundings = _opened(load(arguments.config), opened, arguments)
            print(f"{arguments.config}: its devices are there; Ctrl-C ends", flush=True)
            ends_s = time.monotonic() + arguments.seconds
            truth = opened.enter_context(arguments.truth.open("w")) if arguments.truth else None
            while time.monotonic() < ends_s:
                surroundings.step()
                if truth is not None:
                    pose = surroundings.map_from_base
                    where = f"{pose.x_m:.4f} {pose.y_m:.4f} {pose.theta_rad:.5f}"
                    print(f"{time.monotonic_ns()} {where}", file=truth, flush=True)
    except KeyboardInterrupt:
        return 130
    except (ConfigError, ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else 1
    return 0


def _opened(config: Config, opened: ExitStack, arguments: argparse.Namespace) -> Surroundings:
    scanners = {}
    for scanner in config.scanners:
        device = opened.enter_context(standing_in.scanner(scanner.driver, scanner.options))
        mounting = scanner.mounting.mounting
        scanners[scanner.name] = device, mounting.base_from_lidar, mounting.upside_down
    wheels = standing_in.odometry(config.odometry.driver, config.odometry.options)
    return Surroundings(
        scanners,
        opened.enter_context(wheels),
        config.drive,
        seed=arguments.seed,
        scan_period_s=arguments.scan_period,
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("config", type=Path, help="whose devices to be")
    add("--seed", type=int, default=7, help="of the laboratory and all noise")
    add("--scan-period", type=float, default=0.2, help="s, of every scanner")
    add("--truth", type=Path, help="file for where it really is: monotonic ns, x m, y m, rad")
    add("--seconds", type=float, default=math.inf, help="how long")
    return parser


if __name__ == "__main__":
    sys.exit(main())
