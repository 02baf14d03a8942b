"""Which ROS 2 keys the robot speaks and hears."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Final

from annotated_types import Gt, Interval, Len

_TOPIC: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_FRAME: Final = re.compile(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Settings:
    """The same poses for ROS 2 programs, with no ROS on the robot. Off unless a kind of keys is
    switched on: plain or rmw_zenoh."""

    plain: bool = False
    """Messages on <namespace>/<topic>: for zenoh-bridge-ros2dds and Open-RMF's free_fleet."""
    rmw_zenoh: bool = False
    """Messages, and the robot in the ROS graph, as nodes with rmw_zenoh expect them."""
    domain: Annotated[int, Interval(ge=0, le=232)] = 0
    """ROS_DOMAIN_ID of those nodes."""
    type_hashes: bool = True
    """False: for ROS 2 Humble, whose types have no hashes."""
    namespace: Annotated[str, Len(0, 128)] | None = None
    """Before each topic: namespace amr7 makes amr7/tf. Not given: the robot's name. Empty: none, so
    that RViz finds /tf where it looks first; then one robot a domain."""
    map_frame: Annotated[str, Len(1, 64)] = "map"
    """Frame of the map. An initial pose has to be in it."""
    odom_frame: Annotated[str, Len(0, 64)] = "odom"
    """Frame of the wheels alone, between map and robot. Empty: tf holds the robot in the map
    directly, and there is no odom topic."""
    base_frame: Annotated[str, Len(1, 64)] = "base_footprint"
    """Frame of the robot: middle of the drive axle, on the floor."""
    speed_sigma_mps: Annotated[float, Gt(0), Interval(le=10)] = 0.05
    """Standard deviation of the speed in odom, in m/s, for those who fuse it."""
    turn_sigma_radps: Annotated[float, Gt(0), Interval(le=10)] = 0.05
    """The same of the rate of turn, in rad/s."""
    initialpose: bool = False
    """Take initial poses (RViz's 2D Pose Estimate) as set_pose. Who may publish there commands the
    robot."""

    def __post_init__(self) -> None:
        if self.namespace and not _TOPIC.fullmatch(self.namespace):
            raise ValueError(
                f"namespace: {self.namespace!r} should be names of letters, digits and '_', no "
                "digit first, joined by '/'"
            )
        frames = [self.map_frame, self.base_frame]
        frames += [self.odom_frame] if self.odom_frame else []
        for frame in frames:
            if not _FRAME.fullmatch(frame):
                raise ValueError(
                    f"{frame!r}: a frame should be letters, digits, '_', '-', '.' and '/' inside"
                )
        if len(set(frames)) < len(frames):
            raise ValueError("map_frame, odom_frame and base_frame should differ")
        if self.initialpose and not self.is_on:
            raise ValueError("initialpose needs plain or rmw_zenoh, the keys that it comes in on")

    @property
    def is_on(self) -> bool:
        return self.plain or self.rmw_zenoh

    def namespace_of(self, robot: str) -> str:
        """The namespace of a robot of this name. Raises ValueError when the name makes none."""
        if self.namespace is not None:
            return self.namespace
        if not _TOPIC.fullmatch(robot):
            raise ValueError(
                f"is missing: the robot's name {robot!r} makes none, as ROS 2 has names "
                "of letters, digits and '_', no digit first"
            )
        return robot
