"""An initial pose of ROS 2: CDR from the network that moves the robot."""

from __future__ import annotations

import contextlib
import struct

from amr_slam.encodings.ros2.cdr import HEADER
from amr_slam.encodings.ros2.initialpose import read_initialpose
from amr_slam.wire import SetPose, WireError

_FRAME = "map"


def target(data: bytes) -> None:
    """What is not refused is a command that passes its own checks again."""
    for payload in (data, HEADER + data):
        with contextlib.suppress(WireError):
            command = read_initialpose(payload, _FRAME)
            assert SetPose.decode(command.encode()) == command
            assert command.radius >= 0.5


def seeds() -> list[bytes]:
    """RViz's, one without covariance, one in another frame, one that leans."""
    level, leaning = (0.0, 0.0, 0.6, 0.8), (0.6, 0.0, 0.0, 0.8)
    return [
        _message(_FRAME, level, 0.25),
        _message(_FRAME, level, 0.0),
        _message("odom", level, 0.25),
        _message(_FRAME, leaning, 0.25),
        _message(_FRAME, level, 0.25)[4:],
    ]


def _message(frame: str, turn: tuple[float, float, float, float], variance: float) -> bytes:
    name = frame.encode() + b"\x00"
    start = struct.pack("<iII", 1_790_000_000, 5, len(name)) + name
    start += bytes(-len(start) % 8)
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = covariance[35] = variance
    return HEADER + start + struct.pack("<43d", 1.5, -2.0, 0.0, *turn, *covariance)
