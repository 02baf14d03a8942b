"""Poses, health, maps and scans as messages that Foxglove draws without being told how.

Plain JSON values in Foxglove's well-known schemas; for recordings and for the live server alike.
Source: https://docs.foxglove.dev/docs/visualization/message-schemas/introduction.
"""

from amr_slam.foxglove.messages import (
    Fields,
    as_bytes,
    grid,
    log,
    points,
    pose_fields,
    pose_in_frame,
    time_fields,
    transforms,
)
from amr_slam.foxglove.robot import Health, Robot
from amr_slam.foxglove.schemas import (
    GRID,
    LOG,
    POINT_CLOUD,
    POSE_IN_FRAME,
    SCENE_UPDATE,
    SCHEMAS,
    TRANSFORMS,
)

__all__ = [
    "GRID",
    "LOG",
    "POINT_CLOUD",
    "POSE_IN_FRAME",
    "SCENE_UPDATE",
    "SCHEMAS",
    "TRANSFORMS",
    "Fields",
    "Health",
    "Robot",
    "as_bytes",
    "grid",
    "log",
    "points",
    "pose_fields",
    "pose_in_frame",
    "time_fields",
    "transforms",
]
