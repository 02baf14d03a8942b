"""From instances to scans: is it ours, is it new, does it measure, and when was it. Pure."""

from __future__ import annotations

from math import radians
from typing import Final

import numpy as np

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety.blocks import Header, Instance, Status, ranges_m
from amr_drivers.sick_safety.instance import decode_instance
from amr_drivers.sick_safety.settings import Settings
from amr_drivers.sick_safety.variables import AHEAD_DEG
from amr_drivers.timing import ArrivalClock
from amr_slam.samples import Scan

_STILL_PERIODS: Final = 2.5
"""A scan number that stands still for so many periods is frozen; who polls fast sees it twice."""


class Sweeps:
    """Scans of one scanner, and what hinders them."""

    def __init__(self, name: str, settings: Settings, *, wait_s: float = 0.0) -> None:
        """``wait_s``: for so long a scan may have been lying in the device when it was fetched."""
        self._name = name
        self._settings = settings
        self._limit_ns = round(1e9 * (settings.latency_limit_s + wait_s))
        self._clock = ArrivalClock(self._limit_ns)
        self._number: int | None = None
        self._advanced_ns = 0
        self._last_ns: int | None = None
        self._header: Header | None = None
        self._scan_time_s: float | None = None
        self._beams: int | None = None
        self.hindrance: str | None = None
        """What keeps the newest instance from being a scan."""
        self.remark: str | None = None
        """What the scanner complains of while it measures."""
        self.refused = 0
        """Instances that break the protocol."""
        self.late = 0
        """Scans that came too late to be believed."""

    @property
    def period_s(self) -> float | None:
        """Time between two scans that are sent; None before the first."""
        scan_time_s = self._scan_time_s
        return None if scan_time_s is None else scan_time_s * self._settings.every_nth

    def scan(self, data: bytes, arrival_ns: int) -> Scan | None:
        """The scan in an instance, or None when it holds none that is new and true."""
        try:
            instance = decode_instance(data)
        except BadTelegram as reason:
            self.refused += 1
            self.hindrance = str(reason)
            return None
        return self._scan(instance, arrival_ns)

    def drop_late(self, reason: str) -> None:
        """A scan of unknown age was not taken."""
        self.late += 1
        self.hindrance = reason

    def facts(self) -> tuple[tuple[str, str], ...]:
        """What the instances say of the scanner, as (name, value)."""
        header, scan_time_s = self._header, self._scan_time_s
        facts: list[tuple[str, str]] = []
        if header is not None:
            letter, *version = header.version
            facts.append(("serial number", str(header.serial_number)))
            facts.append(("system plug", str(header.plug_number)))
            facts.append(("data version", letter + ".".join(map(str, version))))
        if scan_time_s is not None:
            facts.append(("beams", str(self._beams)))
            facts.append(("scan time", f"{1e3 * scan_time_s:.0f} ms"))
        return tuple(facts)

    def _scan(self, instance: Instance, arrival_ns: int) -> Scan | None:
        header, status = instance.header, instance.status
        self.hindrance = self._stranger(header) or _not_measuring(status)
        self.remark = None if status is None else _remark(status)
        if self.hindrance is not None:
            # The scan number stands still or jumps meanwhile: it tells nothing of the time.
            self._clock = ArrivalClock(self._limit_ns)
            self._number = None
            return None
        self._header = header
        derived, beams = instance.derived, instance.beams
        if derived is None or beams is None:
            self.hindrance = (
                "the channel does not send derived values and measurement data: switch them on"
            )
            return None
        self._scan_time_s, self._beams = 1e-3 * derived.scan_time_ms, derived.beams
        if not self._advances(header.scan_number, arrival_ns):
            return None
        completed_ns = self._clock.refine(header.scan_number, arrival_ns)
        if completed_ns is None:
            self.late += 1
            return None
        settings = self._settings
        ranges = ranges_m(derived, beams)
        ranges[ranges > settings.range_max_m] = np.inf
        stamp_ns = completed_ns - round(1e9 * (derived.sweep_s + settings.transfer_delay_s))
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            self.late += 1
            return None
        self._last_ns = stamp_ns
        return Scan(
            scanner=self._name,
            stamp_ns=stamp_ns,
            ranges_m=ranges,
            angle_min_rad=radians(derived.start_deg - AHEAD_DEG),
            angle_step_rad=radians(derived.step_deg),
            sweep_s=derived.sweep_s,
            range_max_m=settings.range_max_m,
            seq=header.scan_number,
        )

    def _stranger(self, header: Header) -> str | None:
        if not header.enabled:
            return (
                f"channel {self._settings.channel} is not switched on in the scanner: "
                "enable its data output in Safety Designer"
            )
        wanted, found = self._settings.serial_number, header.serial_number
        if wanted not in (0, found):
            return f"another scanner is at this address: serial number {found}, not {wanted}"
        if header.channel != self._settings.channel:
            return f"data of channel {header.channel} come instead of {self._settings.channel}"
        return None

    def _advances(self, number: int, arrival_ns: int) -> bool:
        if number != self._number:
            self._number, self._advanced_ns = number, arrival_ns
            return True
        still_s = 1e-9 * (arrival_ns - self._advanced_ns)
        if still_s > _STILL_PERIODS * (self.period_s or 0.0):
            self.hindrance = "frozen: the scan number stands still"
        return False


def _not_measuring(status: Status | None) -> str | None:
    if status is None:
        return None
    if status.device_error:
        return "device error: see the scanner's display"
    if status.contamination_error:
        return "contaminated: clean the front screen"
    return "standby" if status.standby else None


def _remark(status: Status) -> str | None:
    remarks = {
        "contamination warning: clean the front screen soon": status.contamination_warning,
        "the reference contour has changed": status.reference_contour,
        "manipulation: the scanner suspects that it is covered": status.manipulation,
        "application error: see the scanner's display": status.application_error,
        "not in run mode": not status.run_mode,
    }
    return "; ".join(text for text, holds in remarks.items() if holds) or None
