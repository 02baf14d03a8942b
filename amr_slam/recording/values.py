"""What a recording holds: the samples in the order of time, and trajectories."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.samples import DriveSample, Raw, Scan

Sample = Scan | DriveSample

# 285 years: whatever claims more is damage, and nanoseconds still fit in 64 bits.
_STAMP_BOUND_S = Decimal(9_000_000_000)


class RecordingError(ValueError):
    """A recording that cannot be read: one line with the file, the place and the reason."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """Poses of one body over time, in one fixed frame."""

    stamps_ns: NDArray[np.int64]
    """(n,) read-only, never decreasing."""
    poses: Array
    """(n, 3) read-only: x m, y m, theta rad."""

    def __post_init__(self) -> None:
        stamps, poses = readonly(self.stamps_ns, np.int64), readonly(self.poses)
        if stamps.ndim != 1 or poses.shape != (len(stamps), 3):
            raise ValueError(f"{stamps.shape} stamps do not fit to {poses.shape} poses")
        if np.any(np.diff(stamps) < 0):
            raise ValueError("stamps must not decrease")
        if not np.isfinite(poses).all():
            raise ValueError("poses must be finite")
        object.__setattr__(self, "stamps_ns", stamps)
        object.__setattr__(self, "poses", poses)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def pose(self, index: int) -> Pose2:
        return Pose2.from_array(self.poses[index])


@dataclass(frozen=True, slots=True, kw_only=True)
class About:
    """Who made a recording, with which software, and when."""

    robot: str
    version: str
    """Of the software."""
    monotonic_ns: int
    """An instant of the clock that all stamps are of ..."""
    utc_ns: int
    """... and what the wall clock said then."""
    config: str = ""
    """Text of the robot's configuration."""
    reason: str = ""
    """Why it was saved."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedDevice:
    """A device whose line was recorded, and what its driver was told: all that decoding needs.

    As read from a file nothing of it has been checked but its form.
    """

    name: str
    kind: Literal["scanner", "odometry"]
    driver: str
    """Name in the registry of drivers."""
    settings: str
    """The driver's settings as a JSON object."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Contents of the files that the settings name, by the field that names each."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Log:
    """A whole recording in memory."""

    samples: tuple[Sample, ...]
    """In the order of time; at equal stamps wheels before scans, else as recorded."""
    truth: Trajectory | None = None
    """World-from-base of the simulator or another reference, where the recording has one."""
    raw: tuple[Raw, ...] = ()
    """What passed on the devices' lines, in the order in which their decoders got it."""
    devices: tuple[RecordedDevice, ...] = ()
    """Those on whose lines that was."""
    about: About | None = None

    def __post_init__(self) -> None:
        ordered = sorted(self.samples, key=lambda s: (s.stamp_ns, isinstance(s, Scan)))
        object.__setattr__(self, "samples", tuple(ordered))


def parse_stamp(text: str) -> int:
    """Decimal seconds to whole nanoseconds without the rounding of a float.

    Raises ValueError when it is no number or not a time between 0 and 285 years.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"{text[:40]!r} is not a time") from None
    if not (seconds.is_finite() and 0 <= seconds < _STAMP_BOUND_S):
        raise ValueError(f"{text[:40]!r} is not a time between 0 and 285 years")
    return round(seconds * 1_000_000_000)
