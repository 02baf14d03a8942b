"""A driver in front of its emulator: what the suite is run on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from amr_drivers.background import ScanDecoder
from amr_drivers.emulators.scanner import EmulatedScanner
from amr_slam.samples import Scanner, Tap, untapped


class Rig(Protocol):
    """One driver in front of its emulator; made anew for each scenario; a context manager."""

    @property
    def name(self) -> str:
        """Driver and way of working. Example: ``sick_cola, polled``."""

    @property
    def beams(self) -> int:
        """Ranges in a scan."""

    @property
    def period_s(self) -> float:
        """Between two sweeps."""

    @property
    def tolerance_m(self) -> float:
        """Rounding of ranges."""

    @property
    def stamp_tolerance_s(self) -> float:
        """How far a stamp may be off, on an idle machine."""

    @property
    def telegram_bytes(self) -> int:
        """Length of one scan on the line: where it may be cut."""

    @property
    def device(self) -> EmulatedScanner:
        """The other end of the line."""

    def open(self, tap: Tap = untapped) -> Scanner:
        """The driver, as the service opens it. Raises DriverError."""

    def decoder(self, start_ns: int) -> ScanDecoder | None:
        """What turns recorded bytes of this driver into scans: its module's ``scan_decoder`` with
        the settings of :meth:`open`; None where the module has none."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


MakeRig = Callable[[Path], Rig]
"""Gets an empty folder."""
