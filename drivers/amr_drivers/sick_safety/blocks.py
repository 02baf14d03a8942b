"""What a scanner tells of one scan, as values.

Source: protocol fact sheet, section C.5. The bytes: :mod:`amr_drivers.sick_safety.instance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, readonly

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint16]

VALID, INFINITE, GLARE, REFLECTOR, CONTAMINATED, CONTAMINATION_WARNING = (1 << n for n in range(6))
"""Bits of a beam's status."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Where in an instance a block lies; without a size it is absent."""

    offset: int = 0
    size: int = 0

    @property
    def present(self) -> bool:
        return self.size > 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """Which scan of which device, and where its blocks lie."""

    version: tuple[str, int, int, int]
    """Letter, major, minor, release; without a letter nothing is valid: the channel is off."""
    serial_number: int
    plug_number: int
    """Serial number of the system plug, which stays when a device is replaced."""
    channel: int
    sequence: int
    """Counts what the channel has sent."""
    scan_number: int
    """Stands still in standby; may jump when the device's state changes."""
    date: int
    """Days since 1972-01-01, or since power-on where the device was not told the date."""
    time_ms: int
    """Of the day: when the data were put together, not when the scan began."""
    status: Block = Block()
    derived: Block = Block()
    beams: Block = Block()
    fields: Block = Block()
    application: Block = Block()
    local_io: Block | None = None
    """Only newer firmware has it, in a longer header."""

    @property
    def enabled(self) -> bool:
        """False: this channel is not switched on in the device."""
        return self.version[0] != "\0"


@dataclass(frozen=True, slots=True, kw_only=True)
class DerivedValues:
    """How the beams lie in angle and time."""

    factor: int
    """Distances are to be multiplied by it."""
    beams: int
    scan_time_ms: int
    """One turn of the mirror."""
    start_deg: float
    """Direction of the first beam as the device has it: 90 is straight ahead."""
    step_deg: float
    interbeam_us: int

    @property
    def sweep_s(self) -> float:
        """Time from the first beam to the last."""
        return 1e-6 * self.interbeam_us * (self.beams - 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The general system state."""

    run_mode: bool = True
    standby: bool = False
    contamination_warning: bool = False
    contamination_error: bool = False
    reference_contour: bool = False
    manipulation: bool = False
    application_error: bool = False
    device_error: bool = False
    safe_off: int = 0
    """Bit n: safe cut-off path n is off."""
    other_off: int = 0
    """The same of paths that are not safety-related."""
    reset_required: int = 0
    """Bit n: cut-off path n waits for a reset."""
    monitoring_cases: tuple[int, ...] = (0, 0, 0, 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beams:
    """What each beam saw; arrays of the same length."""

    distance: Words
    """In mm, before the factor."""
    rssi: Bytes
    status: Bytes

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance", readonly(self.distance, np.uint16))
        object.__setattr__(self, "rssi", readonly(self.rssi, np.uint8))
        object.__setattr__(self, "status", readonly(self.status, np.uint8))

    def __len__(self) -> int:
        return len(self.distance)


@dataclass(frozen=True, slots=True, kw_only=True)
class Instance:
    """All of one scan; None: the device does not send this block."""

    header: Header
    status: Status | None = None
    derived: DerivedValues | None = None
    beams: Beams | None = None


def ranges_m(derived: DerivedValues, beams: Beams) -> Array:
    """(beams,) m: +inf where nothing returned, NaN where a beam did not measure: no valid bit,
    dazzled, or seen through a dirty screen."""
    ranges: Array = 1e-3 * derived.factor * beams.distance.astype(np.float64)
    ranges[((beams.status & VALID) == 0) | (beams.distance == 0)] = np.nan
    ranges[(beams.status & INFINITE) != 0] = np.inf
    ranges[(beams.status & (GLARE | CONTAMINATED)) != 0] = np.nan
    return ranges
