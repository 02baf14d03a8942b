"""From a command's arguments to what the library needs: log, mountings, parameters."""

from __future__ import annotations

import argparse
import logging
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from amr_drivers.decoding import with_decoded
from amr_slam.cli.outputs import UsageError
from amr_slam.config import Config, ConfigError, load
from amr_slam.config.recorded import recorded_settings
from amr_slam.geometry import Pose2
from amr_slam.localizer import Mounting
from amr_slam.map import MapError
from amr_slam.odometry import Odometry, PoseOdometry, joints_of
from amr_slam.params import SlamParams, preset
from amr_slam.recording import Log, RecordedDevice, RecordingError, Sample, read_log
from amr_slam.replay import thin_scans
from amr_slam.samples import Scan

_log = logging.getLogger(__name__)


FAILURES: Final[dict[type[Exception], int]] = {
    UsageError: 2,
    ConfigError: 2,
    MapError: 1,
    RecordingError: 1,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Source:
    """A recording, thinned as asked, and the robot that made it."""

    path: Path
    log: Log
    samples: tuple[Sample, ...]
    """The log's, at most one scan of each scanner in ``--scan-period``."""
    mountings: dict[str, Mounting]
    """Of every scanner in the log."""
    config: Config | None
    slam: SlamParams

    @property
    def name(self) -> str:
        """The file's name without its endings."""
        return self.path.name.split(".", 1)[0]

    @property
    def duration_s(self) -> float:
        return 1e-9 * (self.samples[-1].stamp_ns - self.samples[0].stamp_ns)


def open_source(arguments: argparse.Namespace) -> Source:
    """Read configuration and log. Raises what is in FAILURES."""
    config = load(arguments.config) if arguments.config is not None else None
    log = _read(arguments.log)
    if not any(isinstance(sample, Scan) for sample in log.samples):
        raise RecordingError(f"{arguments.log}: holds no scan")
    return Source(
        path=arguments.log,
        log=log,
        samples=tuple(thin_scans(log.samples, arguments.scan_period)),
        mountings=_mountings(log, config, arguments),
        config=config,
        slam=config.slam if config is not None else preset(arguments.preset),
    )


def _read(path: Path) -> Log:
    """The log; where it has the devices' bytes, with what the drivers make of them."""
    log = read_log(path)
    if log.about is not None:
        begun = datetime.fromtimestamp(log.about.utc_ns // 1_000_000_000, UTC)
        _log.info(
            "%s: recorded by robot %s, amr-slam %s, %s",
            *(path, log.about.robot, log.about.version, begun.isoformat()),
        )
    try:
        return with_decoded(log, _settings)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error


def _settings(device: RecordedDevice) -> object:
    try:
        return recorded_settings(device)
    except ConfigError as error:
        raise RecordingError(f"/raw/{device.name}: settings: {error}") from error


def _mountings(
    log: Log, config: Config | None, arguments: argparse.Namespace
) -> dict[str, Mounting]:
    names = sorted({sample.scanner for sample in log.samples if isinstance(sample, Scan)})
    if arguments.lidar is not None:
        x_m, y_m, theta_deg = arguments.lidar
        everywhere = Mounting(base_from_lidar=Pose2(x_m, y_m, math.radians(theta_deg)))
        return dict.fromkeys(names, everywhere)
    if config is None:
        if len(names) > 1:
            raise UsageError(
                f"{arguments.log}: where do its scanners sit ({', '.join(names)})? "
                "Name the robot's --config, or --lidar X,Y,THETA_DEG for all of them"
            )
        _log.warning("no --config and no --lidar: %s is taken for the robot's origin", names[0])
        return {names[0]: Mounting(base_from_lidar=Pose2.identity())}
    known = {scanner.name: scanner.mounting.mounting for scanner in config.scanners}
    for name in names:
        if name not in known:
            raise UsageError(
                f"{arguments.config}: scanners: {name}, a scanner in {arguments.log}, is not among "
                f"{', '.join(sorted(known))}"
            )
    return {name: known[name] for name in names}


def odometry(source: Source) -> Odometry:
    """What turns the log's wheel samples into motion. Raises RecordingError and UsageError."""
    kinds = {joints_of(sample) for sample in source.samples if not isinstance(sample, Scan)}
    if not kinds:
        raise RecordingError(f"{source.path}: holds no odometry")
    if len(kinds) > 1:
        found = " and ".join(sorted(map(_kind, kinds)))
        raise RecordingError(f"{source.path}: holds {found}")
    (joints,) = kinds
    if source.config is None:
        if joints:
            raise UsageError(
                f"{source.path}: holds {_kind(joints)}: a --config must tell the drive's measures"
            )
        return PoseOdometry()
    drive = source.config.drive
    if drive.joints != joints:
        raise UsageError(
            f"{source.path}: holds {_kind(joints)}; the configuration's drive.kind is made for "
            f"{_kind(drive.joints)}"
        )
    return drive


def _kind(joints: tuple[str, ...]) -> str:
    return f"wheel angles ({', '.join(joints)})" if joints else "integrated poses"
