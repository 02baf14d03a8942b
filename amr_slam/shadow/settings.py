"""How a camera system speaks, and what its poses are compared with."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final, Literal

from annotated_types import Gt, Interval, Len

from amr_slam.geometry import Pose2

_KEY: Final = re.compile(r"[^/?#$\s]+(/[^/?#$\s]+)*")
_FIELD: Final = re.compile(r"[^.\s]+(\.[^.\s]+)*")

Field = Annotated[str, Len(0, 128)]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSettings:
    """One frame in another."""

    x_m: Annotated[float, Interval(ge=-1e6, le=1e6)] = 0.0
    """In m."""
    y_m: Annotated[float, Interval(ge=-1e6, le=1e6)] = 0.0
    """In m."""
    theta_deg: Annotated[float, Interval(ge=-360, le=360)] = 0.0
    """Counter-clockwise."""

    @property
    def pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, math.radians(self.theta_deg))


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadowSettings:
    """A camera system whose poses are compared with the robot's, never used. Off without a key."""

    key: Annotated[str, Len(1, 256)] | None = None
    """Zenoh key expression on which it publishes JSON, e.g. ``cameras/amr7/pose``."""
    entries: Field = ""
    """Where a message holds a list of robots: the list's field; the robot's own entry is taken."""
    x: Field = "x"
    """Field of the position: names joined by dots, numbers for places in a list, e.g.
    ``pose.position.0``."""
    y: Field = "y"
    """The same."""
    theta: Field = "theta"
    """Field of the heading; empty where there is none."""
    stamp: Field = "stamp"
    """Field of the time at which the picture was taken; empty: the time of its arrival counts."""
    robot: Field = ""
    """Field that says which robot is meant; empty where the key alone does."""
    robot_id: Annotated[str, Len(0, 64)] = ""
    """What that field says of this robot; empty: its name."""
    length_unit: Literal["m", "mm"] = "m"
    """Of ``x`` and ``y``: ``m`` or ``mm``."""
    angle_unit: Literal["rad", "deg"] = "rad"
    """Of ``theta``: ``rad`` or ``deg``; counter-clockwise."""
    time_unit: Literal["s", "ms", "us", "ns", "iso"] = "s"
    """Of ``stamp``: ``s``, ``ms``, ``us`` or ``ns`` since 1970 in UTC, or ``iso``, a text as
    2026-11-24T18:05:08.25Z."""
    clock_s: Annotated[float, Interval(ge=-1e10, le=1e10)] | None = None
    """This added to its stamps is the robot's time, in s. Without it: estimated from the turns."""
    map_from_camera: FrameSettings = field(default_factory=FrameSettings)
    """Where the cameras' frame lies in the map; as it is for a map that was aligned to it."""
    base_from_marker: FrameSettings = field(default_factory=FrameSettings)
    """Where the marker sits on the robot, as ``amr-slam map align`` finds it."""
    zone_m: Annotated[float, Interval(ge=0.5, le=1000)] = 5.0
    """Differences are also told by squares of this side, in m."""
    directory: Path = Path("shadow")
    """Where ``<robot>-shadow.csv`` grows, which ``amr-slam map align --pairs`` reads."""
    file_period_s: Annotated[float, Interval(ge=0, le=3600)] = 1.0
    """At most one line of it in this time, in s."""
    file_mb: Annotated[float, Gt(0), Interval(le=4096)] = 64.0
    """A file of so many megabytes is kept as ``<robot>-shadow.1.csv``, and a new one is begun."""

    def __post_init__(self) -> None:
        if self.key is not None and not _KEY.fullmatch(self.key):
            raise ValueError("key should be names or '*' joined by '/'")
        for name in ("entries", "x", "y", "theta", "stamp", "robot"):
            path = getattr(self, name)
            if path and not _FIELD.fullmatch(path):
                raise ValueError(f"{name} should be names joined by dots")
        if not (self.x and self.y):
            raise ValueError("x and y must be named")
