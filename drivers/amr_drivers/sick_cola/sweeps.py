"""When a scan's first beam was measured, by the device's own clock. Pure.

A telegram's "time since start-up" is the end of the sweep on some devices (LMS1xx, TiM) and its
start on others (LMS5xx). The time of transmission tells them apart: a scan cannot be sent before
its sweep is over, so that less than a sweep between the two proves the end. Where only a part of
the sweep is sent, less than half a turn is taken for it: devices that tell the end are seen to send
after 3 to 8 ms, those that tell the start after a whole turn (fact sheet, B.6).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.meaning import ANGLE_UNITS, exact_step_deg
from amr_drivers.sick_cola.scandata import (
    Channel,
    ScanData,
)

_WRAP_US = 2**32
_SENT_WITHIN_US = 10_000_000
"""A later transmission is no time of transmission."""
_SLOWEST_HZ = 0.5
_FASTEST_HZ = 1000.0
_FULL_FIELDS = (
    (re.compile(r"LMS.?1", re.IGNORECASE), (-45.0, 225.0)),
    (re.compile(r"LMS.?5", re.IGNORECASE), (-5.0, 185.0)),
    (re.compile(r"TIM.?[57]", re.IGNORECASE), (-45.0, 225.0)),
)
"""Model -> first and last beam of its full sweep, in the device's degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """The part of a turn of the mirror that a telegram tells of."""

    start_deg: float
    """The device's own scale."""
    step_deg: float
    beams: int
    period_s: float
    """One turn of the mirror."""

    @property
    def sweep_s(self) -> float:
        """From the first beam to the last."""
        return (self.beams - 1) * self.step_deg / 360.0 * self.period_s


def sweep_of(scan: ScanData, channel: Channel) -> Sweep:
    """Raises BadTelegram for a sweep that no mirror makes."""
    step_deg, beams = exact_step_deg(channel.angle_step), len(channel.values)
    if beams < 2 or not 0.0 < (beams - 1) * step_deg <= 360.0:
        raise BadTelegram(f"{beams} beams of {step_deg:g} degrees are no sweep")
    frequency_hz = 0.01 * scan.scan_frequency
    if not _SLOWEST_HZ <= frequency_hz <= _FASTEST_HZ:
        raise BadTelegram(f"a scan frequency of {frequency_hz:g} Hz")
    return Sweep(
        start_deg=channel.start_angle / ANGLE_UNITS,
        step_deg=step_deg,
        beams=beams,
        period_s=1.0 / frequency_hz,
    )


class FirstBeam:
    """Finds the first beam's time from a device's telegrams."""

    def __init__(self) -> None:
        self._shortest_us: int | None = None
        self._longest_s = 0.0
        self._full: tuple[float, float] | None = None

    def identify(self, model: str) -> None:
        """The device has told its model: its full sweep may be known."""
        for pattern, field in _FULL_FIELDS:
            if pattern.match(model):
                self._full = field
                return

    def hear(self, scan: ScanData, sweep: Sweep) -> int:
        """The device's time in us at which the telegram was ready to be sent."""
        wait_us = (scan.transmission_us - scan.start_up_us) % _WRAP_US
        if wait_us > _SENT_WITHIN_US:  # no time of transmission: the other one must do
            wait_us = 0
        self._longest_s = max(sweep.sweep_s, 0.5 * sweep.period_s)
        self._shortest_us = (
            wait_us if self._shortest_us is None else min(wait_us, self._shortest_us)
        )
        return (scan.start_up_us + wait_us) % _WRAP_US

    @property
    def told_at_end(self) -> bool:
        """True: the device's time of a scan is the end of its sweep; False: its start."""
        return self._shortest_us is None or 1e-6 * self._shortest_us < self._longest_s

    def after_start_up_s(self, sweep: Sweep) -> float:
        """From the telegram's "time since start-up" to its first beam; negative: before it.

        The device's times are those of its whole sweep, though it may send a part of it only.
        """
        first = sweep.start_deg
        last = first + (sweep.beams - 1) * sweep.step_deg
        full = self._full or (first, last)
        if self.told_at_end:
            return -(max(full[1], last) - first) / 360.0 * sweep.period_s
        return (first - min(full[0], first)) / 360.0 * sweep.period_s
