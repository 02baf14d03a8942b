"""The configuration: TOML in, one frozen tree out, or one line that says what is wrong where."""

from amr_slam.config.checking import ConfigError
from amr_slam.config.tree import (
    Config,
    MapSettings,
    MetricsSettings,
    MountingSettings,
    OdometrySettings,
    RecordingSettings,
    RobotSettings,
    ScannerSettings,
    ServiceSettings,
    load,
    parse,
)

__all__ = [
    "Config",
    "ConfigError",
    "MapSettings",
    "MetricsSettings",
    "MountingSettings",
    "OdometrySettings",
    "RecordingSettings",
    "RobotSettings",
    "ScannerSettings",
    "ServiceSettings",
    "load",
    "parse",
]
