"""The messages themselves, as plain JSON values."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2

Fields = dict[str, Any]

INFO: Final = 2
WARNING: Final = 3
ERROR: Final = 4
"""Levels of a log message."""

_SECOND_NS: Final = 1_000_000_000
_UINT8, _FLOAT32 = 1, 7
_MOST_CELLS: Final = 500_000
"""Of a grid: two megabytes in JSON."""
_WALL, _SEEN, _UNKNOWN = (0, 0, 0, 255), (210, 224, 237, 160), (0, 0, 0, 0)
"""Red, green, blue, alpha of a map's pixels: what nobody saw is not painted over."""


def as_bytes(fields: Fields) -> bytes:
    """Raises ValueError for a number that is none: JSON has neither infinity nor NaN."""
    return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode("ascii")


def time_fields(stamp_ns: int) -> Fields:
    """An instant, as Foxglove writes it in JSON."""
    seconds, rest_ns = divmod(stamp_ns, _SECOND_NS)
    return {"sec": seconds, "nsec": rest_ns}


def point(x_m: float, y_m: float, z_m: float = 0.0) -> Fields:
    """A vector of three dimensions."""
    return {"x": x_m, "y": y_m, "z": z_m}


def turn(theta_rad: float) -> Fields:
    """About the vertical."""
    half = 0.5 * theta_rad
    return {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}


def pose_fields(pose: Pose2, z_m: float = 0.0) -> Fields:
    """A pose on the floor, or ``z_m`` above it."""
    return {"position": point(pose.x_m, pose.y_m, z_m), "orientation": turn(pose.theta_rad)}


def pose_in_frame(stamp_ns: int, frame: str, frame_from_it: Pose2) -> Fields:
    """One pose and the frame that it is in."""
    return {
        "timestamp": time_fields(stamp_ns),
        "frame_id": frame,
        "pose": pose_fields(frame_from_it),
    }


def transforms(stamp_ns: int, parent: str, children: Mapping[str, Pose2]) -> Fields:
    """Where frames lie in their common parent: ``parent_from_child`` by the child's name."""
    return {
        "transforms": [
            {
                "timestamp": time_fields(stamp_ns),
                "parent_frame_id": parent,
                "child_frame_id": child,
                "translation": point(pose.x_m, pose.y_m),
                "rotation": turn(pose.theta_rad),
            }
            for child, pose in children.items()
        ]
    }


def log(stamp_ns: int, level: int, name: str, message: str) -> Fields:
    """A line for the log panel; ``name``: who says it."""
    return {
        "timestamp": time_fields(stamp_ns),
        "level": level,
        "message": message,
        "name": name,
        "file": "",
        "line": 0,
    }


def grid(
    stamp_ns: int,
    frame: str,
    pixels: NDArray[np.uint8],
    metres_per_px: float,
    column_of_x0_px: float,
    row_of_y0_px: float,
) -> Fields:
    """A map's picture: ``pixels`` (rows, columns), 0 a wall, above 250 floor that was seen,
    others unknown; columns grow with x, rows against y. Large ones are made coarser."""
    every = math.ceil(math.sqrt(pixels.size / _MOST_CELLS))
    top_m = row_of_y0_px * metres_per_px
    left_m = -column_of_x0_px * metres_per_px
    pixels, metres_per_px = _coarser(pixels, every), every * metres_per_px
    rows, columns = pixels.shape
    cells = np.empty((rows, columns, 4), dtype=np.uint8)
    cells[:] = _UNKNOWN
    cells[pixels > 250] = _SEEN
    cells[pixels == 0] = _WALL
    return {
        "timestamp": time_fields(stamp_ns),
        "frame_id": frame,
        # Below what lies on the floor; from its lower left corner on.
        "pose": pose_fields(Pose2(left_m, top_m - rows * metres_per_px, 0.0), -0.01),
        "column_count": columns,
        "cell_size": {"x": metres_per_px, "y": metres_per_px},
        "row_stride": 4 * columns,
        "cell_stride": 4,
        "fields": [
            {"name": name, "offset": offset, "type": _UINT8}
            for offset, name in enumerate(("red", "green", "blue", "alpha"))
        ],
        "data": base64.b64encode(cells[::-1].tobytes()).decode("ascii"),
    }


def _coarser(pixels: NDArray[np.uint8], every: int) -> NDArray[np.uint8]:
    """The darkest of each ``every`` by ``every`` pixels: a thin wall stays one."""
    rows, columns = (-(-side // every) for side in pixels.shape)
    room = np.full((rows * every, columns * every), 255, dtype=np.uint8)
    room[: pixels.shape[0], : pixels.shape[1]] = pixels
    blocks: NDArray[np.uint8] = room.reshape(rows, every, columns, every).min(axis=(1, 3))
    return blocks


def points(stamp_ns: int, frame: str, points_m: Array) -> Fields:
    """(n, 2) points in m in a frame, at its height 0."""
    return {
        "timestamp": time_fields(stamp_ns),
        "frame_id": frame,
        "pose": pose_fields(Pose2.identity()),
        "point_stride": 12,
        "fields": [
            {"name": name, "offset": offset, "type": _FLOAT32}
            for name, offset in (("x", 0), ("y", 4), ("z", 8))
        ],
        "data": base64.b64encode(
            np.pad(points_m.reshape(-1, 2), ((0, 0), (0, 1))).astype("<f4").tobytes()
        ).decode("ascii"),
    }
