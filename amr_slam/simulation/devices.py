"""Scanners of different kinds as models: view, resolution, range, rounding, noise along the beam.

The figures are those of the data sheets; 1 cm of noise is what such scanners show on real walls.
The paper's noise in x and y is added by ``replace(model, sigma_xy_m=...)``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from amr_slam.simulation.scanner import ScannerModel


def _scanner(
    view_deg: float, beams: int, range_max_m: float, *, quantum_m: float, turn_s: float
) -> ScannerModel:
    return ScannerModel(
        beams=beams,
        angle_min_rad=math.radians(-0.5 * view_deg),
        angle_step_rad=math.radians(view_deg / (beams - 1)),
        range_max_m=range_max_m,
        quantum_m=quantum_m,
        sigma_range_m=0.01,
        sweep_s=turn_s * view_deg / 360.0,
    )


SCANNERS: Final[Mapping[str, ScannerModel]] = MappingProxyType(
    {
        "S300": _scanner(270.0, 541, 30.0, quantum_m=0.01, turn_s=0.04),
        "LMS111 0.5": _scanner(270.0, 541, 20.0, quantum_m=0.001, turn_s=0.02),
        "LMS111 0.25": _scanner(270.0, 1081, 20.0, quantum_m=0.001, turn_s=0.04),
        "TiM571": _scanner(270.0, 811, 25.0, quantum_m=0.001, turn_s=1.0 / 15.0),
        "office 8 m": _scanner(180.0, 181, 8.0, quantum_m=0.01, turn_s=1.0 / 75.0),
        "office 81 m": _scanner(180.0, 181, 81.0, quantum_m=0.01, turn_s=1.0 / 75.0),
        "microScan3 0.5": _scanner(275.0, 551, 40.0, quantum_m=0.001, turn_s=0.03),
        "microScan3 0.125": _scanner(275.0, 2201, 40.0, quantum_m=0.001, turn_s=0.04),
    }
)
"""By the device and, where it has several, the resolution in degrees or the range; "office" is
the 180 degree scanner of most public recordings."""
