"""Which scanner to be. Figures from recordings of real ones (fact sheet, B.4 to B.6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class ColaModel:
    """What one type of scanner sends."""

    ident: tuple[str, str]
    firmware: str
    serial_number: int
    version: int = 1
    start_angle: int
    """1/10000 degree."""
    step_deg: float
    beams: int
    scan_frequency: int
    """1/100 Hz."""
    measurement_frequency: int
    """100 Hz."""
    intensity_bits: Literal[0, 8, 16] = 0
    scale: float = 1.0
    told: Literal["start", "end"]
    """Which end of the sweep the telegram's time since start-up is."""
    processing_s: float
    """From the sweep's end to the transmission."""
    range_max_m: float
    unknown: frozenset[str] = frozenset()
    """Variables that this one has not: it answers sFA 3."""

    @property
    def period_s(self) -> float:
        """One turn of the mirror."""
        return 100.0 / self.scan_frequency

    @property
    def sweep_s(self) -> float:
        """From the first beam to the last."""
        return (self.beams - 1) * self.step_deg / 360.0 * self.period_s


LMS111 = ColaModel(
    ident=("LMS10x_FieldEval", "V1.80-08.09.2014"),
    firmware="V1.80-08.09.2014",
    serial_number=18090362,
    start_angle=-450_000,
    step_deg=0.5,
    beams=541,
    scan_frequency=5000,
    measurement_frequency=360,
    told="end",
    processing_s=0.0031,
    range_max_m=20.0,
)
LMS511 = ColaModel(
    ident=("LMS5xx", "V1.80"),
    firmware="V1.80",
    serial_number=18110550,
    version=0,
    start_angle=-50_000,
    step_deg=1.0 / 6.0,
    beams=1141,
    scan_frequency=2500,
    measurement_frequency=540,
    intensity_bits=8,
    told="start",
    processing_s=0.0197,
    range_max_m=80.0,
)
TIM571 = ColaModel(
    ident=("TiM5xx", "V2.60"),
    firmware="V2.60",
    serial_number=17271466,
    start_angle=-450_000,
    step_deg=1.0 / 3.0,
    beams=811,
    scan_frequency=1500,
    measurement_frequency=162,
    intensity_bits=8,
    told="end",
    processing_s=0.0049,
    range_max_m=25.0,
)
TIM781 = ColaModel(
    ident=("TiM7xx", "V3.13"),
    firmware="V3.13",
    serial_number=18480390,
    start_angle=-450_000,
    step_deg=1.0 / 3.0,
    beams=811,
    scan_frequency=1500,
    measurement_frequency=162,
    intensity_bits=16,
    told="end",
    processing_s=0.0077,
    range_max_m=25.0,
)
MODELS = {"LMS111": LMS111, "LMS511": LMS511, "TiM571": TIM571, "TiM781": TIM781}
