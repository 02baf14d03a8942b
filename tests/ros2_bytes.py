"""Messages of ROS 2 by an independent serializer, and a map for them, for the tests."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from messages import MAP_ID
from rosbags.typesys import Stores, get_typestore

from amr_slam.encodings import MapPicture
from amr_slam.encodings.ros2.keys import POSE, Type
from amr_slam.map.export import FREE, OCCUPIED, UNKNOWN, OccupancyImage, png_bytes
from amr_slam.serving import Asked, ImageWanted, Picture
from amr_slam.wire import MapImage, PoseMessage

STORE = get_typestore(Stores.ROS2_JAZZY)


def name_of(kind: Type) -> str:
    return f"{kind.package}/msg/{kind.name}"


def ros(name: str, /, **fields: Any) -> Any:
    """A message of rosbags' own classes."""
    return STORE.types[name](**fields)


def serialized(kind: Type, message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, name_of(kind)))


def deserialized(kind: Type, payload: bytes) -> Any:
    return STORE.deserialize_cdr(payload, name_of(kind))


def header(stamp_ns: int, frame: str) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    stamp = ros("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return ros("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def vector(x: float, y: float, z: float, name: str = "Vector3") -> Any:
    return ros(f"geometry_msgs/msg/{name}", x=x, y=y, z=z)


def quaternion(theta_rad: float) -> Any:
    half = 0.5 * theta_rad
    return ros("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))


def pose(x: float, y: float, theta_rad: float) -> Any:
    at = vector(x, y, 0.0, "Point")
    return ros("geometry_msgs/msg/Pose", position=at, orientation=quaternion(theta_rad))


def covariance(planar: tuple[float, ...]) -> np.ndarray[Any, np.dtype[np.float64]]:
    whole = np.zeros((6, 6))
    whole[np.ix_([0, 1, 5], [0, 1, 5])] = np.reshape(planar, (3, 3))
    return whole.ravel()


def ros_pose(stamp_ns: int, frame: str, message: PoseMessage) -> Any:
    return ros(
        name_of(POSE),
        header=header(stamp_ns, frame),
        pose=ros(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=pose(message.x, message.y, message.theta),
            covariance=covariance(message.covariance),
        ),
    )


# -- a map


def picture_of(seq: int = 0) -> MapPicture:
    """Two rows of three: the wall is low and to the right of (1 m, -2 m)."""
    pixels = np.array([[UNKNOWN, FREE, FREE], [FREE, FREE, OCCUPIED]], dtype=np.uint8)
    at = MapImage(
        map=MAP_ID,
        width_px=3,
        height_px=2,
        metres_per_px=0.5,
        column_of_x0_px=-2.0,
        row_of_y0_px=-2.0,
    )
    return MapPicture(seq=seq, stamp=1_790_000_000.0, pixels=pixels, georeference=at)


def loop_that_draws(drawn: list[Asked]) -> Callable[[Asked], object]:
    picture = picture_of()
    image = OccupancyImage(pixels=picture.pixels, resolution_m=0.5, x_min_m=1.0, y_min_m=-2.0)

    def loop(asked: Asked) -> None:
        assert asked.request == ImageWanted(resolution_m=None)
        drawn.append(asked)
        asked.done(Picture(png=png_bytes(image), georeference=picture.georeference))

    return loop
