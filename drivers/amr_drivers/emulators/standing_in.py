"""Which emulator stands in for the devices of which driver: a literal table."""

from __future__ import annotations

import importlib
from typing import Any, Final, cast

from amr_drivers.emulators.odometry import EmulatedOdometry
from amr_drivers.emulators.scanner import StandIn

_SCANNERS: Final = {
    "sick_cola": "amr_drivers.emulators.cola",
    "sick_s300": "amr_drivers.emulators.s300",
    "sick_safety": "amr_drivers.emulators.safety",
}
_ODOMETRY: Final = {
    "can": "amr_drivers.emulators.odometry",
    "cia402": "amr_drivers.emulators.odometry",
}


def scanner(driver: str, settings: Any) -> StandIn:
    """The scanner that a driver's settings name, at its address on this machine.

    Raises ValueError for a driver or settings that cannot be emulated, OSError when the address
    cannot be had.
    """
    return cast("StandIn", _emulate(_SCANNERS, driver, settings))


def odometry(driver: str, settings: Any) -> EmulatedOdometry:
    """The wheels that a driver's settings name. Raises as :func:`scanner`."""
    return cast("EmulatedOdometry", _emulate(_ODOMETRY, driver, settings))


def _emulate(table: dict[str, str], driver: str, settings: Any) -> Any:
    if driver not in table:
        raise ValueError(f"driver {driver} has no emulator; there are {', '.join(sorted(table))}")
    return importlib.import_module(table[driver]).emulate(settings)
