"""CARMEN logs: the text format of the public 2D benchmarks.

Source: the message definitions in the head of the logs themselves
(http://carmen.sourceforge.net/logger_playback.html). Times are the first of the two of each
line (the sensor's), kept in the log's own time base.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from amr_slam.geometry import Array, Pose2
from amr_slam.recording.text import read_lines
from amr_slam.recording.values import Log, RecordingError, Sample, parse_stamp
from amr_slam.samples import OdometrySample, Scan

# The custom of the format: FLASER readings from here on mean "nothing seen" (SICK LMS, 8183 cm).
NO_RETURN_M = 81.83
# FLASER and RLASER tell the number of readings only: a half circle from -90 degrees.
_OLD_LASER_STEPS_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
_BEAMS_BOUND = 20_000

# Other messages of the CARMEN logger. Whatever else begins a line is damage.
_IGNORED = re.compile(
    r"PARAM|SYNC|MARKER|TRUEPOS|SCANMARK|POSITION|SONAR|BUMPER|ARM|PANTILT|LASER[345]|REMISSION"
    r"|RAWLASER[1-5]|ROBOTLASER[345]|NMEA(GGA|GGAQ|RMC|HDT)|GPS|IMU|XSENS|CAMERAIMAGE|VECTORMOVE"
    r"|ROBOTVELOCITY|BASEVELOCITY|FOLLOWTRAJECTORY"
)


def read_carmen(path: Path) -> Log:
    """All ODOM, FLASER, RLASER, ROBOTLASER1 and ROBOTLASER2 messages of a plain or gzip log.

    Scanners are named after their message in lower case. A log without ODOM gives the robot
    poses in its laser messages as odometry. Raises RecordingError on the first damaged line.
    """
    samples: list[Sample] = []
    poses_of_lasers: list[Sample] = []
    for number, line in read_lines(path):
        try:
            match _message(line.split()):
                case OdometrySample() as odometry:
                    samples.append(odometry)
                case (scan, pose):
                    samples.append(scan)
                    poses_of_lasers.append(pose)
        except ValueError as error:
            raise RecordingError(f"{path}:{number}: {error}") from None
    if not samples:
        raise RecordingError(f"{path}: holds no odometry and no scan")
    if not any(isinstance(sample, OdometrySample) for sample in samples):
        samples += poses_of_lasers
    return Log(samples=tuple(samples))


def _message(fields: list[str]) -> OdometrySample | tuple[Scan, OdometrySample] | None:
    match fields[0]:
        case "ODOM":
            return _odometry(fields)
        case "FLASER" | "RLASER":
            return _old_laser(fields)
        case "ROBOTLASER1" | "ROBOTLASER2":
            return _robot_laser(fields)
        case keyword if _IGNORED.fullmatch(keyword):
            return None
        case keyword:
            raise ValueError(f"unknown message {keyword[:40]!r}")


def _odometry(fields: list[str]) -> OdometrySample:
    """ODOM x y theta tv rv accel time host logger_time."""
    _expect_fields(fields, 10)
    return OdometrySample(
        stamp_ns=parse_stamp(fields[7]), odom_from_base=_pose(_finite(fields[1:7])[:3])
    )


def _old_laser(fields: list[str]) -> tuple[Scan, OdometrySample]:
    """FLASER n ranges(n) laser_pose(3) robot_pose(3) time host logger_time."""
    beams = _count(fields, 1)
    if beams not in _OLD_LASER_STEPS_DEG:
        known = ", ".join(str(n) for n in _OLD_LASER_STEPS_DEG)
        raise ValueError(f"{fields[0]} of {beams} readings, known are {known}")
    _expect_fields(fields, beams + 11)
    tail = _finite(fields[beams + 2 : beams + 8])
    stamp_ns = parse_stamp(fields[beams + 8])
    scan = Scan(
        scanner=fields[0].lower(),
        stamp_ns=stamp_ns,
        ranges_m=_ranges(fields[2 : beams + 2], NO_RETURN_M),
        angle_min_rad=-0.5 * math.pi,
        angle_step_rad=math.radians(_OLD_LASER_STEPS_DEG[beams]),
        range_max_m=NO_RETURN_M,
    )
    return scan, OdometrySample(stamp_ns=stamp_ns, odom_from_base=_pose(tail[3:]))


def _robot_laser(fields: list[str]) -> tuple[Scan, OdometrySample]:
    """ROBOTLASER1 type start fov step max_range accuracy remission_mode n ranges(n) m
    remissions(m) laser_pose(3) robot_pose(3) tv rv safety(2) turn_axis time host logger_time."""
    beams = _count(fields, 8)
    remissions = _count(fields, beams + 9)
    tail = beams + remissions + 10
    _expect_fields(fields, tail + 14)
    start_rad, fov_rad, step_rad, range_max_m = _finite(fields[2:6])
    poses = _finite(fields[tail : tail + 11])
    if not (abs(start_rad) <= 2.0 * math.pi and 0.0 <= fov_rad <= 2.0 * math.pi + 0.1):
        raise ValueError(f"field of view of {fov_rad} rad from {start_rad} rad")
    if not (step_rad > 0.0 and (beams - 1) * step_rad <= 2.0 * math.pi + 0.1):
        raise ValueError(f"{beams} readings {step_rad} rad apart are no scan")
    if not range_max_m > 0.0:
        raise ValueError(f"maximum range of {range_max_m} m")
    stamp_ns = parse_stamp(fields[tail + 11])
    scan = Scan(
        scanner=fields[0].lower(),
        stamp_ns=stamp_ns,
        ranges_m=_ranges(fields[9 : beams + 9], range_max_m),
        angle_min_rad=start_rad,
        angle_step_rad=step_rad,
        range_max_m=range_max_m,
    )
    return scan, OdometrySample(stamp_ns=stamp_ns, odom_from_base=_pose(poses[3:6]))


def _expect_fields(fields: list[str], expected: int) -> None:
    if len(fields) != expected:
        raise ValueError(f"{fields[0]} has {len(fields)} fields instead of {expected}")


def _count(fields: list[str], index: int) -> int:
    if index >= len(fields) or not fields[index].isdecimal() or len(fields[index]) > 6:
        raise ValueError(f"{fields[0]} has no number of readings in field {index + 1}")
    count = int(fields[index])
    if count > _BEAMS_BOUND:
        raise ValueError(f"{count} readings are more than {_BEAMS_BOUND}")
    return count


def _finite(fields: list[str]) -> list[float]:
    numbers = [float(field) for field in fields]
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{' '.join(fields)[:80]!r} must be finite numbers")
    return numbers


def _pose(xyt: list[float]) -> Pose2:
    return Pose2(xyt[0], xyt[1], xyt[2])


def _ranges(fields: list[str], no_return_m: float) -> Array:
    ranges = np.fromiter(map(float, fields), np.float64, len(fields))
    ranges[~(ranges > 0.0)] = np.nan
    ranges[ranges >= no_return_m] = np.inf
    return ranges
