"""Drivers by name: a table, and plug-ins from other distributions by entry point.

A plug-in names its module under ``amr_slam.scanners`` or ``amr_slam.odometry``::

    [project.entry-points."amr_slam.scanners"]
    acme_lidar = "acme_amr.lidar"

The module has a frozen dataclass ``Settings`` (str, int, float, bool, Literal, tuples of these and
further frozen dataclasses only: the configuration checks it generically) and ``open_scanner(name,
settings, tap)`` or ``open_odometry(settings, tap)``. For recordings of the devices' bytes and
frames to be replayed it has ``scan_decoder(name, settings, start_ns)``
(:class:`amr_drivers.background.ScanDecoder`) or ``wheel_decoder(settings, start_ns)``
(:class:`amr_drivers.decoding.WheelDecoder`) as well, and ``FILES``, a tuple of the settings that
are paths of files which decoding needs, if there are any: recordings take their contents along, and
decoding finds them at other paths. An odometry's ``Settings`` may tell by ``joints`` what its
samples hold, so that a ``[drive]`` made for others is refused at the start. A module is imported
when its name is asked for, not before: nobody needs the libraries of a device that he does not
have.
"""

from __future__ import annotations

import difflib
import importlib
from importlib.metadata import entry_points
from typing import Any, Protocol, cast

from amr_slam.samples import FrameTap, OdometrySource, Scanner, Tap

_SCANNERS = {
    "mock": "amr_drivers.mock.scanner",
    "replay": "amr_drivers.replay.scanner",
    "sick_cola": "amr_drivers.sick_cola.driver",
    "sick_s300": "amr_drivers.sick_s300.driver",
    "sick_safety": "amr_drivers.sick_safety.driver",
}
_ODOMETRY = {
    "can": "amr_drivers.can_odometry.driver",
    "cia402": "amr_drivers.can_odometry.cia402.driver",
    "mock": "amr_drivers.mock.odometry",
    "replay": "amr_drivers.replay.odometry",
}


class ScannerModule(Protocol):
    """What a scanner's module must have."""

    @property
    def Settings(self) -> type[Any]: ...  # noqa: N802 - a class in the module

    def open_scanner(self, name: str, settings: Any, tap: Tap = ...) -> Scanner:
        """``tap`` is given all bytes of the device as they come and go, for recordings.

        Raises DriverError: not there; ValueError: settings that can never work.
        """


class OdometryModule(Protocol):
    """What an odometry's module must have."""

    @property
    def Settings(self) -> type[Any]: ...  # noqa: N802 - a class in the module

    def open_odometry(self, settings: Any, tap: FrameTap = ...) -> OdometrySource:
        """``tap`` is given all frames of the bus as they come, for recordings.

        Raises DriverError: not there; ValueError: settings that can never work.
        """


def scanner_names() -> list[str]:
    """All scanner drivers that can be named in a configuration, sorted."""
    return sorted(_table(_SCANNERS, "amr_slam.scanners"))


def odometry_names() -> list[str]:
    """All odometry drivers that can be named in a configuration, sorted."""
    return sorted(_table(_ODOMETRY, "amr_slam.odometry"))


def scanner_module(driver: str) -> ScannerModule:
    """The module of a scanner driver. Raises ValueError for an unknown or unusable one."""
    table = _table(_SCANNERS, "amr_slam.scanners")
    return cast("ScannerModule", _module("scanner", driver, table, "open_scanner"))


def odometry_module(driver: str) -> OdometryModule:
    """The module of an odometry driver. Raises ValueError for an unknown or unusable one."""
    table = _table(_ODOMETRY, "amr_slam.odometry")
    return cast("OdometryModule", _module("odometry", driver, table, "open_odometry"))


def file_fields(module: ScannerModule | OdometryModule) -> tuple[str, ...]:
    """The settings of a driver that are paths of files which decoding needs."""
    fields: tuple[str, ...] = getattr(module, "FILES", ())
    return fields


def _table(own: dict[str, str], group: str) -> dict[str, str]:
    return own | {point.name: point.value for point in entry_points(group=group)}


def _module(kind: str, driver: str, table: dict[str, str], function: str) -> Any:
    if driver not in table:
        near = difflib.get_close_matches(driver, table, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(sorted(table))}"
        raise ValueError(f"no {kind} driver is named {driver!r}; {hint}")
    try:
        module = importlib.import_module(table[driver])
    except ImportError as error:
        raise ValueError(f"{kind} driver {driver!r} cannot be loaded: {error}") from error
    missing = [name for name in ("Settings", function) if not hasattr(module, name)]
    if missing:
        raise ValueError(f"{kind} driver {driver!r}: {table[driver]} has no {missing[0]}")
    return module
