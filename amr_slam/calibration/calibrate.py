"""From a recording to the robot's measures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from amr_slam.calibration.adjustment import adjust
from amr_slam.calibration.sightings import CalibrationError, find_sightings
from amr_slam.calibration.values import Calibration, Measures, ScannerMeasures
from amr_slam.calibration.wheels import WheelTrack
from amr_slam.localizer import Mounting
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.samples import Scan, WheelSample

__all__ = ["calibrate"]


def calibrate(
    samples: Sequence[Scan | WheelSample],
    drive: DifferentialDrive,
    mountings: dict[str, Mounting],
    params: SlamParams,
    *,
    scan_period_s: float = 0.5,
    on_progress: Callable[[int], None] | None = None,
) -> Calibration:
    """The measures of the robot that made a recording.

    ``samples`` in the order of time; ``drive`` and ``mountings`` (by scanner) as configured.
    Two rounds: the second deskews, and expects scans, by what the first found.
    Raises CalibrationError: no wheels, no scans, or scans that do not fit together.
    """
    wheels = [sample for sample in samples if isinstance(sample, WheelSample)]
    if len(wheels) < 100:
        raise CalibrationError("the recording holds no wheel angles: record the wheels' counts")
    seen = {sample.scanner for sample in samples if isinstance(sample, Scan)}
    scanners = [name for name in mountings if name in seen]
    if not scanners:
        raise CalibrationError("the recording holds no scan of a scanner in the configuration")
    given = Measures(
        radius_left_m=drive.radius_left_m,
        radius_right_m=drive.radius_right_m,
        track_m=drive.track_m,
        scanners=tuple(
            ScannerMeasures(
                name=name,
                base_from_lidar=mountings[name].base_from_lidar,
                lag_s=mountings[name].lag_s,
            )
            for name in scanners
        ),
    )
    track = WheelTrack(wheels)
    sightings = find_sightings(samples, given, mountings, params, scan_period_s, on_progress)
    first = adjust(given, given, sightings, track)
    sightings = find_sightings(
        samples, first.measures, mountings, params, scan_period_s, on_progress
    )
    return adjust(given, first.measures, sightings, track)
