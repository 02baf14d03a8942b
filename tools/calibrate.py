"""A robot's wheel radii, track, mountings and clock lags from one recorded drive.

Drive for some minutes where there are walls all around, with straight stretches, turns to both
sides and turns on the spot. Prints the measures with their uncertainty and the lines for the
configuration; exit status 1 when the recording cannot tell, or with --check when it refutes the
configuration.

Example: python tools/calibrate.py drive.mcap --config config/robot.toml --plot out/drive.png
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from amr_slam.calibration import CalibrationError, calibrate
from amr_slam.calibration.report import config_lines, describe, drifted, plot
from amr_slam.cli.arguments.values import path_ending
from amr_slam.config import ConfigError, load
from amr_slam.odometry import DifferentialDrive
from amr_slam.recording import RecordingError, read_log
from amr_slam.samples import Scan, WheelSample


def main() -> int:
    """Parse, calibrate, print."""
    arguments = _parser().parse_args()
    try:
        return _run(arguments)
    except (CalibrationError, RecordingError) as error:
        print(f"{arguments.log}: {error}", file=sys.stderr)
        return 1
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2


def _run(arguments: argparse.Namespace) -> int:
    config = load(arguments.config)
    if not isinstance(config.drive, DifferentialDrive):
        raise ConfigError("only a differential drive can be calibrated", ("drive", "kind"))
    log = read_log(arguments.log)
    found = calibrate(
        [sample for sample in log.samples if isinstance(sample, Scan | WheelSample)],
        config.drive,
        {scanner.name: scanner.mounting.mounting for scanner in config.scanners},
        config.slam,
        scan_period_s=arguments.scan_period,
    )
    print("\n".join(describe(found)))
    if arguments.plot is not None:
        plot(found, arguments.plot)
    drift = drifted(found)
    if arguments.check:
        print("\n".join(drift) if drift else "the configuration agrees with this drive")
        return int(bool(drift))
    print()
    print("\n".join(config_lines(found)))
    return int(bool(found.doubts()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("log", type=Path, help="native recording (.mcap) with wheel angles and scans")
    add("--config", type=Path, required=True, help="the robot's configuration: where to start from")
    add("--scan-period", type=float, default=0.5, help="s, at most one scan of each scanner in it")
    add(
        "--plot",
        type=path_ending(".png", ".svg"),
        help="picture of the drive and of what is left between wheels and scans (PNG or SVG)",
    )
    add("--check", action="store_true", help="only tell whether the robot still is as configured")
    return parser


if __name__ == "__main__":
    sys.exit(main())
