"""``/initialpose``: what RViz's "2D Pose Estimate" sends, as the command that it stands for."""

from __future__ import annotations

import json
import math
from typing import Final

from amr_slam.encodings.ros2.cdr import CdrReader
from amr_slam.wire import SetPose, WireError

_SIGMAS: Final = 3.0
_LEAST_RADIUS_M: Final = 0.5
"""Many senders leave the covariance 0: nobody points at a map more exactly than this."""
_MAX_FRAME: Final = 128
_LEAST_UPRIGHT: Final = 0.98
"""Cosine of the angle (11 degrees) by which the pose may lean."""
_NORM: Final = 0.01
"""By so much may a quaternion's length differ from 1."""


def read_initialpose(payload: bytes, map_frame: str) -> SetPose:
    """The place to search around; radius: three standard deviations of the worst direction.

    The stamp is not looked at: the robot is about there now. Raises WireError, one line, for what
    is no ``geometry_msgs/PoseWithCovarianceStamped`` in ``map_frame``, or no place on the floor.
    """
    reader = CdrReader(payload)
    reader.int32()
    reader.uint32()
    frame = reader.string(_MAX_FRAME)
    numbers = reader.float64s(7 + 36)
    reader.end()
    if frame != map_frame:
        raise WireError(f"in frame {frame!r:.80}, not in {map_frame!r}")
    if not all(map(math.isfinite, numbers)):
        raise WireError("a number in it is not finite")
    x, y, _, qx, qy, qz, qw = numbers[:7]
    place = {"x": x, "y": y, "theta": _yaw_rad(qx, qy, qz, qw), "radius": _radius_m(numbers[7:])}
    return SetPose.decode(json.dumps(place).encode())  # the command's own bounds


def _yaw_rad(qx: float, qy: float, qz: float, qw: float) -> float:
    if abs(math.hypot(qx, qy, qz, qw) - 1.0) > _NORM:
        raise WireError("its orientation is no unit quaternion")
    if 1.0 - 2.0 * (qx * qx + qy * qy) < _LEAST_UPRIGHT:
        raise WireError("it does not stand upright")
    return math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


def _radius_m(covariance: tuple[float, ...]) -> float:
    xx, xy, yx, yy = covariance[0], covariance[1], covariance[6], covariance[7]
    if xx < 0.0 or yy < 0.0:
        raise WireError("a variance in it is negative")
    largest = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), 0.5 * (xy + yx))
    return max(_LEAST_RADIUS_M, _SIGMAS * math.sqrt(largest))
