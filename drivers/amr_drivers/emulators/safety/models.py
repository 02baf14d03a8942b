"""Which scanner to be. Figures from the devices' data sheets."""

from __future__ import annotations

from dataclasses import dataclass

from amr_drivers.sick_safety.blocks import DerivedValues


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyModel:
    """What one type of scanner sends."""

    type_code: str
    firmware: str
    serial_number: int
    plug_number: int
    derived: DerivedValues
    header_bytes: int = 76
    """Where the first block of an instance lies: 52 with old firmware, 76 in SICK's manual."""
    sessions: int = 4
    """Over CoLa 2, at a time."""

    @property
    def period_s(self) -> float:
        """One turn of the mirror."""
        return 1e-3 * self.derived.scan_time_ms


MICROSCAN3 = SafetyModel(
    type_code="MICS3-ACAZ40AZ1P01",
    firmware="R01.51.0",
    serial_number=17_479_021,
    plug_number=17_469_324,
    derived=DerivedValues(
        factor=1, beams=706, scan_time_ms=40, start_deg=-47.5, step_deg=0.39, interbeam_us=43
    ),
)
NANOSCAN3 = SafetyModel(
    type_code="NANS3-CAAZ30AN1",
    firmware="R01.92.0",
    serial_number=21_080_042,
    plug_number=21_070_311,
    derived=DerivedValues(
        factor=1, beams=1651, scan_time_ms=30, start_deg=-47.5, step_deg=1 / 6, interbeam_us=14
    ),
)
MODELS = {"microScan3": MICROSCAN3, "nanoScan3": NANOSCAN3}
