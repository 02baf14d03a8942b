"""The configuration's sections, and :func:`load`.

Ports, DBC files and maps are paths as the daemon sees them: relative ones start at its working
directory, not at the configuration file.
"""

from __future__ import annotations

import difflib
import math
import os.path
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, get_args

from annotated_types import Ge, Gt, Interval, Len
from pydantic import AfterValidator

from amr_drivers import registry
from amr_slam.config.checking import ConfigError, checked, located, read_toml, shown
from amr_slam.encodings.ros2 import Ros2Settings
from amr_slam.encodings.vda5050 import Vda5050Settings
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.living import AcceptPolicy
from amr_slam.mounting import Mask, Mounting
from amr_slam.odometry import Odometry, drive_kinds
from amr_slam.params import Preset, SlamParams, preset
from amr_slam.samples import WHEELS
from amr_slam.shadow import ShadowSettings
from amr_slam.states import Mode
from amr_slam.trust import LocalizerParams
from amr_slam.wire import ZenohSettings

_T = TypeVar("_T")

# By these fields of a driver's Settings two devices are seen to be one.
_ADDRESS_FIELDS: Final = ("host", "port", "channel", "path")


def _key_safe(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
        raise ValueError("should be 1 to 64 letters, digits, '_', '-' or '.', no such sign first")
    return name


Name = Annotated[str, AfterValidator(_key_safe)]


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSettings:
    """Which robot this is."""

    name: Name
    """Part of its Zenoh keys and of its recordings' names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometrySettings:
    """Where the wheel samples come from."""

    driver: str
    """Name in the registry, e.g. ``can``."""
    options: Any = field(default_factory=dict)
    """A table in the file; after loading the driver's ``Settings``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MountingSettings:
    """Where a scanner sits: its measuring centre in the robot's base frame (x ahead, y left)."""

    x_m: Annotated[float, Interval(ge=-20, le=20)]
    """Ahead of the base frame's origin, in m."""
    y_m: Annotated[float, Interval(ge=-20, le=20)]
    """Left of it, in m."""
    theta_deg: Annotated[float, Interval(ge=-360, le=360)]
    """Direction of its middle beam, counter-clockwise from straight ahead."""
    upside_down: bool = False
    """Hangs head down: its beams run clockwise, seen from above."""
    lag_s: Annotated[float, Interval(ge=-1, le=1)] = 0.0
    """Its stamps are late by this against the wheels', in s; ``tools/calibrate.py`` finds it."""
    masks: tuple[Mask, ...] = ()
    """Sectors in which it sees the robot itself, as ``{ from_deg = -135.0, to_deg = -120.0 }``:
    bearings counter-clockwise from ``theta_deg``, seen from above; with ``closer_than_m = 0.4``
    only nearer readings are dropped."""

    @property
    def mounting(self) -> Mounting:
        pose = Pose2(self.x_m, self.y_m, math.radians(self.theta_deg))
        return Mounting(
            base_from_lidar=pose,
            upside_down=self.upside_down,
            lag_s=self.lag_s,
            masks=self.masks,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannerSettings:
    """One scanner."""

    name: Name
    """What messages and recordings call it."""
    driver: str
    """Name in the registry, e.g. ``sick_s300``."""
    poll_period_s: Annotated[float, Ge(0), Interval(le=60)] = 2.0
    """At most one scan in this time is used, in s: 0.5 Hz is the paper's; 0 takes every scan."""
    mounting: MountingSettings
    options: Any = field(default_factory=dict)
    """A table in the file; after loading the driver's ``Settings``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSettings:
    """Which map."""

    mode: Mode
    """``mapping`` starts a new map, ``localization`` drives in one that exists."""
    path: Path | None = None
    """Localization: the ``.amrmap`` file."""
    directory: Path = Path("maps")
    """Mapping: where ``<name>.amrmap`` is saved."""
    name: Name = "map"
    """Mapping: the new map's name."""
    extend: bool = False
    """Mapping: a map of that name which is there already grows on, once the robot is found in it;
    otherwise a new one begins, and the old one stays as a version of the file."""
    hold: bool = True
    """Extending: what is in the map at first stays as it is; false lets scans improve it."""
    accept: AcceptPolicy = field(default_factory=AcceptPolicy)
    """Localization: changes that become a new version of the map without a person."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceSettings:
    """The daemon's own times."""

    publish_hz: Annotated[float, Gt(0), Interval(le=200)] = 50.0
    """Poses per second: one for a wheel sample, and without one where wheels are silent."""
    save_period_s: Annotated[float, Interval(ge=5, le=3600)] = 60.0
    """While mapping, the map is saved this often in s: what a power cut may cost."""
    reconnect_max_s: Annotated[float, Interval(ge=0.5, le=60)] = 5.0
    """A lost device is tried again after 0.5 s, then ever less often, up to this."""
    answer_limit_s: Annotated[float, Interval(ge=1, le=300)] = 30.0
    """A registration that takes longer than this, in s, is given up and its process restarted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricsSettings:
    """Figures for Prometheus under ``http://HOST:PORT/metrics``."""

    port: Annotated[int, Interval(ge=0, le=65535)] = 0
    """0: none. 9464 is a usual one."""
    host: str = "127.0.0.1"
    """Address to listen on: this computer only, unless opened up. There is no password."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSettings:
    """What the daemon keeps of the last minutes, to be saved when something was odd."""

    directory: Path = Path("recordings")
    """Where ``<robot>-<UTC>-<reason>.mcap`` is saved when somebody asks for it (SIGUSR1, command
    save_recording); under ``automatic/`` what is saved by itself when the robot gets worse."""
    ring_s: Annotated[float, Interval(ge=0, le=86400)] = 600.0
    """So many seconds are kept in memory, all bytes of all devices; 0 keeps nothing."""
    ring_mb: Annotated[float, Gt(0), Interval(le=4096)] = 64.0
    """At most so many megabytes of memory for it, whatever the time; the oldest goes first."""
    automatic_mb: Annotated[float, Interval(ge=0, le=1_000_000)] = 500.0
    """At most so many megabytes of disk for what is saved by itself, the oldest goes first; 0 saves
    nothing by itself."""
    automatic_count: Annotated[int, Interval(ge=1, le=10_000)] = 20
    """At most so many of these recordings."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """All that the daemon is told."""

    robot: RobotSettings
    drive: Odometry
    odometry: OdometrySettings
    scanners: tuple[ScannerSettings, ...]
    map: MapSettings
    slam: SlamParams
    fusion: FilterParams
    localizer: LocalizerParams
    zenoh: ZenohSettings
    ros2: Ros2Settings
    vda5050: Vda5050Settings
    service: ServiceSettings
    recording: RecordingSettings
    shadow: ShadowSettings
    metrics: MetricsSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class _File:
    """The file's top level; tables that depend on a choice inside them are read later."""

    robot: RobotSettings
    drive: dict[str, Any]
    odometry: OdometrySettings
    scanners: Annotated[tuple[ScannerSettings, ...], Len(1, 16)]
    map: MapSettings
    slam: dict[str, Any] = field(default_factory=dict)
    fusion: FilterParams = field(default_factory=FilterParams)
    localizer: LocalizerParams = field(default_factory=LocalizerParams)
    zenoh: ZenohSettings = field(default_factory=ZenohSettings)
    ros2: Ros2Settings = field(default_factory=Ros2Settings)
    vda5050: Vda5050Settings = field(default_factory=Vda5050Settings)
    service: ServiceSettings = field(default_factory=ServiceSettings)
    recording: RecordingSettings = field(default_factory=RecordingSettings)
    shadow: ShadowSettings = field(default_factory=ShadowSettings)
    metrics: MetricsSettings = field(default_factory=MetricsSettings)


def load(file: Path) -> Config:
    """The configuration in ``file``. Raises ConfigError for anything that is not right in it."""
    with located(file=file):
        return parse(read_toml(file))


def parse(table: Mapping[str, Any]) -> Config:
    """The configuration in a table as TOML gives it. Raises ConfigError."""
    read = checked(_File, table)
    with located("drive"):
        try:
            kinds = drive_kinds()
        except ValueError as error:
            raise ConfigError(str(error), ("kind",)) from error
        drive, rest = _chosen(read.drive, "kind", kinds, *kinds.values())
        motion: Odometry = checked(drive, rest)
    with located("slam"):
        presets: dict[str, Preset] = {name: name for name in get_args(Preset)}
        base, rest = _chosen(read.slam, "preset", presets, SlamParams, default="default")
        slam = checked(SlamParams, rest, preset(base))
    with located("odometry"):
        options = _driver_options(registry.odometry_module, read.odometry)
        odometry = replace(read.odometry, options=options)
    scanners = []
    for index, scanner in enumerate(read.scanners):
        with located("scanners", index):
            options = _driver_options(registry.scanner_module, scanner)
            scanners.append(replace(scanner, options=options))
    config = Config(
        robot=read.robot,
        drive=motion,
        odometry=odometry,
        scanners=tuple(scanners),
        map=read.map,
        slam=slam,
        fusion=read.fusion,
        localizer=read.localizer,
        zenoh=read.zenoh,
        ros2=read.ros2,
        vda5050=read.vda5050,
        service=read.service,
        recording=read.recording,
        shadow=read.shadow,
        metrics=read.metrics,
    )
    _cross_check(config)
    return config


def _cross_check(config: Config) -> None:
    """What no section can see alone."""
    # Drivers of one kind of wheels alone need not tell: what does not fit is then found in use.
    given = getattr(config.odometry.options, "joints", config.drive.joints)
    if given != config.drive.joints:
        raise ConfigError(
            f"gives {_joints(given)}, and drive.kind needs {_joints(config.drive.joints)}",
            ("odometry", "options"),
        )
    names = {WHEELS: "odometry"}
    addresses = {_address(config.odometry.options): "odometry.options"}
    for index, scanner in enumerate(config.scanners):
        here = f"scanners[{index}]"
        with located("scanners", index):
            if (other := names.setdefault(scanner.name, here)) != here:
                raise ConfigError(f"{scanner.name} is also the name of {other}", ("name",))
            address = _address(scanner.options)
            if address and (other := addresses.setdefault(address, here)) != here:
                raise ConfigError(f"{address} is also the address of {other}", ("options",))
    if config.ros2.is_on:
        with located("ros2", "namespace"):
            _check_ros2_namespace(config)
    with located("map", "path"):
        if config.map.mode == "mapping" and config.map.path is not None:
            raise ConfigError("is for localization; mapping saves <directory>/<name>.amrmap")
        if config.map.mode == "localization" and config.map.path is None:
            raise ConfigError("is missing: localization needs a map")
        if config.map.path is not None and not os.path.isfile(config.map.path):
            raise ConfigError(f"there is no file {config.map.path}")


def _check_ros2_namespace(config: Config) -> None:
    try:
        namespace = config.ros2.namespace_of(config.robot.name)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if config.ros2.plain and namespace == f"{config.zenoh.prefix}/{config.robot.name}":
        raise ConfigError(f"{namespace} is where the robot's own messages go: pose would be two")


def _chosen(
    table: Mapping[str, Any],
    key: str,
    among: Mapping[str, _T],
    *others: type[Any],
    default: str | None = None,
) -> tuple[_T, dict[str, Any]]:
    """What ``table[key]`` names, and the rest of the table: the keys of the ``others``."""
    rest = dict(table)
    name = rest.pop(key, None)
    if name is None:
        strangers = rest.keys() - {field.name for other in others for field in fields(other)}
        for stranger in difflib.get_close_matches(key, sorted(strangers), n=1):
            raise ConfigError(f"unknown key; did you mean {key}?", (stranger,))
        name = default
    if name is None:
        raise ConfigError("is missing", (key,))
    if not isinstance(name, str) or name not in among:
        raise ConfigError(f"should be one of: {', '.join(among)}; not {shown(name)}", (key,))
    return among[name], rest


def _driver_options(
    find: Callable[[str], registry.ScannerModule | registry.OdometryModule],
    device: ScannerSettings | OdometrySettings,
) -> object:
    """The driver's own ``Settings`` from the table under ``options``."""
    try:
        settings: type[object] = find(device.driver).Settings
    except ValueError as error:
        raise ConfigError(str(error), ("driver",)) from error
    with located("options"):
        return checked(settings, device.options)


def _joints(names: tuple[str, ...]) -> str:
    return " and ".join(names) or "integrated poses"


def _address(settings: object) -> str:
    """Empty where the device has none, as simulated ones do."""
    found = (getattr(settings, name, None) for name in _ADDRESS_FIELDS)
    return ":".join(str(value) for value in found if value is not None)
