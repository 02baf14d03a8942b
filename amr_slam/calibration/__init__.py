"""A robot's measures from one recorded drive: wheel radii, track, mountings and clock offsets.

No targets and no tape: the scanners' own poses in a map that the drive itself makes are held
against what the wheels say, over all pairs of instants at once. Three pages: ``sightings`` (a pose
of the scanner for each scan), ``wheels`` (the path that given measures make of the counts) and
``adjustment`` (the measures that make both agree best, and how well the drive tells them).
"""

from amr_slam.calibration.adjustment import adjust
from amr_slam.calibration.calibrate import calibrate
from amr_slam.calibration.sightings import CalibrationError
from amr_slam.calibration.values import Calibration, Measures, ScannerMeasures, Sightings

__all__ = [
    "Calibration",
    "CalibrationError",
    "Measures",
    "ScannerMeasures",
    "Sightings",
    "adjust",
    "calibrate",
]
