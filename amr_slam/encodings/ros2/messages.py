"""Our messages as those of ROS 2, field by field as their definitions have them (ROS 2 Humble to
Jazzy). All planar: z, roll and pitch are 0, and so are their variances, as amcl writes them."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import Final

import numpy as np

from amr_slam.encodings.base import MapPicture
from amr_slam.encodings.ros2.cdr import CdrWriter
from amr_slam.geometry import Pose2
from amr_slam.map.export import FREE, OCCUPIED
from amr_slam.states import State
from amr_slam.wire import HealthPart, PoseMessage, ScanMessage, StatusMessage

_PLANAR: Final = ((0, 0), (1, 1), (5, 2))
"""Row of (x, y, z, roll, pitch, yaw), and which of (x, y, theta) it is."""
_UNKNOWN: Final = 1e6
"""Variance of what drifts without bound."""
_FLOAT32: Final = 7
"""PointField's number of the type."""

_CELLS: Final = np.full(256, -1, dtype=np.int8)
"""What an occupancy grid has for each grey value."""
_CELLS[OCCUPIED], _CELLS[FREE] = 100, 0

OK, WARN, ERROR = 0, 1, 2
_LEVELS: Final = {
    State.STARTING: WARN,
    State.LOCALIZED: OK,
    State.MAPPING: OK,
    State.ODOMETRY_ONLY: WARN,
    State.AMBIGUOUS: ERROR,
    State.LOST: ERROR,
}
_LINK_LEVELS: Final = {"OK": OK, "STALE": WARN, "LOST": ERROR}


@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """``std_msgs/Header``."""

    stamp_ns: int
    """UTC since 1970."""
    frame: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Transform:
    """``geometry_msgs/TransformStamped``: ``child`` in the header's frame."""

    header: Header
    child: str
    pose: Pose2


def fits(stamp_ns: int) -> bool:
    """Whether ROS 2 has a number for it: its seconds end in 2038."""
    return 0 <= stamp_ns < (1 << 31) * 1_000_000_000


def pose_with_covariance(header: Header, message: PoseMessage) -> bytes:
    """``geometry_msgs/PoseWithCovarianceStamped``: the pose in the map."""
    writer = CdrWriter()
    _header(writer, header)
    _pose(writer, Pose2(message.x, message.y, message.theta))
    writer.float64s(*_covariance36(message.covariance))
    return writer.bytes()


def odometry(
    header: Header,
    child: str,
    message: PoseMessage,
    speed_sigma_mps: float,
    turn_sigma_radps: float,
) -> bytes:
    """``nav_msgs/Odometry``: the pose by the wheels alone, and the speeds.

    That pose drifts without bound, so its variances say that nothing is known of it in the long
    run: use its steps, or the speeds.
    """
    writer = CdrWriter()
    _header(writer, header)
    writer.string(child)
    _pose(writer, Pose2(message.odom.x, message.odom.y, message.odom.theta))
    writer.float64s(*_diagonal36(_UNKNOWN, _UNKNOWN, _UNKNOWN))
    writer.float64s(message.vx, 0.0, 0.0, 0.0, 0.0, message.omega)
    writer.float64s(*_diagonal36(speed_sigma_mps**2, speed_sigma_mps**2, turn_sigma_radps**2))
    return writer.bytes()


def transforms(several: Sequence[Transform]) -> bytes:
    """``tf2_msgs/TFMessage``."""
    writer = CdrWriter()
    writer.uint32(len(several))
    for transform in several:
        _header(writer, transform.header)
        writer.string(transform.child)
        _pose(writer, transform.pose)
    return writer.bytes()


def points(header: Header, message: ScanMessage) -> bytes:
    """``sensor_msgs/PointCloud2``: x, y, z as float32."""
    writer = CdrWriter()
    _header(writer, header)
    count = len(message.points)
    writer.uint32(1)
    writer.uint32(count)
    writer.uint32(3)
    for number, name in enumerate("xyz"):
        writer.string(name)
        writer.uint32(4 * number)
        writer.uint8(_FLOAT32)
        writer.uint32(1)
    writer.uint8(0)  # little-endian
    writer.uint32(12)
    writer.uint32(12 * count)
    flat = chain.from_iterable((x, y, 0.0) for x, y in message.points)
    writer.uint32(12 * count)
    writer.raw(struct.pack(f"<{3 * count}f", *flat))
    writer.uint8(1)  # no NaN among them
    return writer.bytes()


def grid(header: Header, picture: MapPicture) -> bytes:
    """``nav_msgs/OccupancyGrid``: 0 free, 100 occupied, -1 unknown; the first row is the lowest."""
    at, rows, columns = picture.georeference, *picture.pixels.shape
    writer = CdrWriter()
    _header(writer, header)
    _time(writer, header.stamp_ns)
    writer.float32(at.metres_per_px)
    writer.uint32(columns)
    writer.uint32(rows)
    left_m = -at.column_of_x0_px * at.metres_per_px
    low_m = (at.row_of_y0_px - rows) * at.metres_per_px
    _pose(writer, Pose2(left_m, low_m, 0.0))
    writer.uint32(rows * columns)
    writer.raw(_CELLS[picture.pixels[::-1]].tobytes())
    return writer.bytes()


def diagnostics(header: Header, message: StatusMessage) -> bytes:
    """``diagnostic_msgs/DiagnosticArray``: the localization, then each device and process."""
    parts = message.health()
    writer = CdrWriter()
    _header(writer, header)
    writer.uint32(1 + len(parts))
    known = message.map
    values = {
        "mode": message.mode,
        "map": "" if known is None else known.name,
        "map id": "" if known is None else known.id,
        "explained": "" if message.explained is None else f"{message.explained:.3f}",
        "places that fit": str(len(message.candidates)),
        "clock steps": str(message.clock_steps),
        "requests refused": str(message.refused_requests),
        "advice": message.advice or "",
        "version": message.version,
        "cpu percent": f"{message.cpu_percent:.1f}",
        "memory MB": f"{message.memory_mb:.1f}",
    }
    said = f"{message.state}: {message.fault}" if message.fault else str(message.state)
    level = max(_LEVELS[message.state], WARN if message.fault else OK)
    _status(writer, level, "amr_slam: localization", said, message.robot, values)
    for name, part in parts.items():
        _part(writer, f"amr_slam: {name}", message.robot, part)
    return writer.bytes()


def _part(writer: CdrWriter, name: str, robot: str, part: HealthPart) -> None:
    values = {
        "age s": "" if part.age_s is None else f"{part.age_s:.3f}",
        "rate Hz": f"{part.rate_hz:.2f}",
        "samples": str(part.samples),
        "errors": str(part.errors),
    }
    said = f"{part.link}: {part.detail}" if part.detail else part.link
    _status(writer, _LINK_LEVELS[part.link], name, said, robot, values)


def _status(
    writer: CdrWriter, level: int, name: str, said: str, hardware: str, values: dict[str, str]
) -> None:
    """``diagnostic_msgs/DiagnosticStatus``."""
    writer.uint8(level)
    for text in (name, said, hardware):
        writer.string(_text(text))
    writer.uint32(len(values))
    for key, value in values.items():
        writer.string(key)
        writer.string(_text(value))


def _header(writer: CdrWriter, header: Header) -> None:
    _time(writer, header.stamp_ns)
    writer.string(header.frame)


def _time(writer: CdrWriter, stamp_ns: int) -> None:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    writer.int32(seconds)
    writer.uint32(nanoseconds)


def _pose(writer: CdrWriter, pose: Pose2) -> None:
    """Position, and the turn around z as a quaternion."""
    half_rad = 0.5 * pose.theta_rad
    writer.float64s(pose.x_m, pose.y_m, 0.0, 0.0, 0.0, math.sin(half_rad), math.cos(half_rad))


def _covariance36(planar: Sequence[float]) -> list[float]:
    """Row-major 6 x 6 from row-major 3 x 3."""
    whole = [0.0] * 36
    for row, i in _PLANAR:
        for column, j in _PLANAR:
            whole[6 * row + column] = planar[3 * i + j]
    return whole


@lru_cache(maxsize=8)  # the same few for each pose
def _diagonal36(x: float, y: float, yaw: float) -> Sequence[float]:
    return _covariance36((x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, yaw))


def _text(text: str) -> str:
    """Without what a C string would end at."""
    return text.replace("\x00", " ")
