"""The pose of the last run, on disk: a hint where to look first after a crash, never a pose.

One small file, replaced whole. It says where a scan is compared with the map first; what is
published comes from scans that agree. It counts for a minute and a half, on one start of the
computer, in one map: who was carried to a look-alike place in that time was carried by running
people. Anything else about it is a reason to ignore it, with a line in the log.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from amr_slam.geometry import Array, Pose2, readonly

MOST_AGE_S: Final = 90.0
_CLOCKS_AGREE_S: Final = 5.0
"""Between the age by the computer's uptime and that by UTC: more, and it was started anew."""
_VERSION: Final = 1
_MAX_BYTES: Final = 4096
_FARTHEST_M: Final = 1e5


class UnusableHint(Exception):  # noqa: N818  # no fault of the program
    """Why there is no hint: one line."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LastPose:
    """Where the robot was, in which map, when."""

    map_id: str
    """UUID of the map file's content; while mapping, of the run."""
    map_name: str
    mapping: bool
    """The map was growing; a run that ends by itself leaves False."""
    map_from_base: Pose2
    covariance: Array
    """(3, 3) read-only."""
    uptime_ns: int
    """Of the computer, sleep included."""
    utc_ns: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", readonly(self.covariance))

    @property
    def spread_m(self) -> float:
        """Three standard deviations of the position along its worst direction."""
        return 3.0 * math.sqrt(float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))


def clocks_ns() -> tuple[int, int]:
    """(uptime with sleep, UTC)."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME), time.time_ns()


def encode(last: LastPose) -> bytes:
    """The file's bytes: a line of JSON and its SHA-256."""
    pose = last.map_from_base
    fields = {
        "v": _VERSION,
        "map": last.map_id,
        "name": last.map_name,
        "mapping": last.mapping,
        "x": pose.x_m,
        "y": pose.y_m,
        "theta": pose.theta_rad,
        "covariance": last.covariance.ravel().tolist(),
        "uptime_ns": last.uptime_ns,
        "utc_ns": last.utc_ns,
    }
    line = json.dumps(fields, allow_nan=False).encode() + b"\n"
    return line + hashlib.sha256(line).hexdigest().encode() + b"\n"


def read(path: Path) -> LastPose:
    """What the last run left in ``path``, of any age. Raises UnusableHint."""
    try:
        with path.open("rb") as stream:
            data = stream.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise UnusableHint("there is none") from None
    except OSError as error:
        raise UnusableHint(f"cannot be read: {error.strerror or error}") from error
    return decode(data)


def must_be_fresh(last: LastPose, uptime_ns: int, utc_ns: int) -> None:
    """Raises UnusableHint unless the robot can hardly have been moved since, by both clocks."""
    age_s = 1e-9 * (uptime_ns - last.uptime_ns)
    by_utc_s = 1e-9 * (utc_ns - last.utc_ns)
    if age_s < 0.0 or abs(by_utc_s - age_s) > _CLOCKS_AGREE_S:
        raise UnusableHint("the computer was started anew, or its clock was set, since")
    if age_s > MOST_AGE_S:
        raise UnusableHint(f"{age_s:.0f} s old: the robot may have been moved")


def decode(data: bytes) -> LastPose:
    """What :func:`encode` made, of any age. Raises UnusableHint."""
    line, _, rest = data.partition(b"\n")
    line += b"\n"
    if len(data) > _MAX_BYTES or rest.strip() != hashlib.sha256(line).hexdigest().encode():
        raise UnusableHint("the file is damaged")
    try:
        return _built(json.loads(line))
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise UnusableHint(f"the file makes no sense: {error!r:.80}") from error


def _built(fields: dict[str, Any]) -> LastPose:
    if fields["v"] != _VERSION:
        raise UnusableHint(f"version {fields['v']!r:.20} of the file is unknown")
    covariance = np.array([_number(value) for value in fields["covariance"]]).reshape(3, 3)
    if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise ValueError("the covariance is none")
    pose = Pose2(*(_number(fields[name]) for name in ("x", "y", "theta")))
    if not isinstance(fields["map"], str) or not isinstance(fields["name"], str):
        raise TypeError("the map has no name")
    return LastPose(
        map_id=fields["map"],
        map_name=fields["name"],
        mapping=bool(fields["mapping"]),
        map_from_base=pose,
        covariance=covariance,
        uptime_ns=int(fields["uptime_ns"]),
        utc_ns=int(fields["utc_ns"]),
    )


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r:.40} is no number")
    if not abs(value) <= _FARTHEST_M:
        raise ValueError(f"{value!r:.40} is no possible number")
    return float(value)
