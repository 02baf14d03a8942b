"""How a robot takes part in VDA 5050."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from annotated_types import Gt, Interval, Le, Len

Version = Literal["2.1", "3.0"]

# What the standard allows in a serial number; all of it may stand in an MQTT topic and a Zenoh key.
_LEVEL: Final = re.compile(r"[A-Za-z0-9_.:-]{1,64}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Vda5050Settings:
    """VDA 5050: the position for fleet controls, on keys that are MQTT topics one to one."""

    versions: Annotated[tuple[Version, ...], Len(0, 2)] = ()
    """``2.1``, ``3.0``, or both at once; none switches it off."""
    interface: str = "uagv"
    """First level of the topics: ``<interface>/v2/<manufacturer>/<serial_number>/...``."""
    manufacturer: str | None = None
    """The vehicle's, as its factsheet has it. Needed as soon as there are versions."""
    serial_number: str | None = None
    """The vehicle's; without it, the robot's name. Access rules of ``amr-slam keys`` go by the
    robot's name."""
    visualization_hz: Annotated[float, Interval(ge=0.1, le=200)] = 10.0
    """At most so many positions a second: every k-th pose, and at once when it begins or ends to be
    trusted, jumps, or the map changes."""
    map_id: Literal["uuid", "name"] = "uuid"
    """What ``mapId`` is: the map's UUID, or its name, where the layout of the fleet control has
    names."""
    trusted_error_m: Annotated[float, Gt(0), Le(100)] = 0.5
    """Beyond this ``error95_m`` the vehicle is not localized for the fleet control, whatever the
    state; ``localizationScore`` falls to 0 at it."""
    trusted_heading_deg: Annotated[float, Gt(0), Le(180)] = 10.0
    """The same for the heading: 1.96 standard deviations of it."""
    take_position: bool = False
    """Whether ``initPosition`` (2.1) and ``initializePosition`` (3.0) among the instant actions set
    the pose. Whoever may publish there may then command the robot."""
    take_radius_m: Annotated[float, Gt(0), Le(10)] = 2.0
    """How far off such a position may be: the robot searches its place around it."""

    def __post_init__(self) -> None:
        levels = {
            "interface": self.interface,
            "manufacturer": self.manufacturer,
            "serial_number": self.serial_number,
        }
        for name, level in levels.items():
            if level is not None and not _LEVEL.fullmatch(level):
                raise ValueError(f"{name} should be 1 to 64 letters, digits, '_', '.', ':' or '-'")
        if len(set(self.versions)) < len(self.versions):
            raise ValueError("versions should name each version once")
        if self.versions and self.manufacturer is None:
            raise ValueError("manufacturer is missing: it is part of every topic")
