"""What a robot says of itself: poses, status, scans, and the picture of its map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Final, Literal, Self

from annotated_types import Ge, Gt, Interval, Le, Len
from pydantic import Field

from amr_slam.states import State
from amr_slam.wire.shadow import ShadowPart
from amr_slam.wire.values import (
    Angle,
    Count,
    Name,
    Part,
    Payload,
    Seconds,
    Share,
    Text,
    Uuid,
    WireError,
)

UNKNOWN: Final = 1e9
"""Stands for "none yet" in ``since_fix_s``, ``since_fix_m`` and ``error95_m``. JSON has no
infinity, and null would pass as 0 in a careless ``error95_m < 0.1``."""

MAX_CANDIDATES: Final = 5
"""Places that a status message tells at most."""
MAX_SLIPS: Final = 5
"""Disagreements of wheels and scans that a status message tells at most."""
MAX_SCAN_POINTS: Final = 2000
"""Points that a scan message holds at most: in mm within 100 km, they fit into a message."""
_MAX_PIXELS: Final = 20_000
_FARTHEST_M: Final = 100_000.0
_Coordinate = Annotated[float, Interval(ge=-_FARTHEST_M, le=_FARTHEST_M)]
_Pixels = Annotated[int, Ge(1), Le(_MAX_PIXELS)]


class OdomPose(Part):
    """The pose by the wheels alone since the start: drifts, never jumps."""

    x: float
    y: float
    theta: Angle


class EpochDelta(Part):
    """What x, y, theta jumped by, in the map frame: the new pose less the old one."""

    x: float
    y: float
    theta: Angle


class CalibrationPart(Part):
    """What was learned of the wheels while driving; ``..._sigma``: its standard deviation."""

    travel_scale: float
    """The true travel by the wheels'."""
    travel_scale_sigma: Annotated[float, Ge(0)]
    yaw_scale: float
    """The true turn by the wheels'."""
    yaw_scale_sigma: Annotated[float, Ge(0)]
    bend_radpm: float
    """Turn in rad that the wheels do not see in each metre ahead."""
    bend_sigma_radpm: Annotated[float, Ge(0)]
    lag_s: float
    """By how much the wheels' stamps are later than the scans'."""
    lag_sigma_s: Annotated[float, Ge(0)]


class SlipPart(Part):
    """The wheels were caught lying."""

    stamp: Seconds
    """UTC seconds of the scan that showed it."""
    forward_m: float
    """So much further ahead did the robot go than its wheels said,"""
    left_m: float
    turn_rad: float
    """and turned so much further to the left."""
    text: Text


class HealthPart(Part):
    """One device's or process's health."""

    link: Literal["OK", "STALE", "LOST"]
    age_s: Seconds | None
    """Since the last good sample; null before the first."""
    rate_hz: Annotated[float, Ge(0)]
    samples: Count
    errors: Count
    detail: Text | None = None


class MapPart(Part):
    """Which map is active."""

    id: Uuid
    """UUID, as in the pose message."""
    name: Name
    version: Count


class ChangesPart(Part):
    """What has been watched of the map's changes; ``amr-slam map diff`` lists them."""

    new: Count
    """Things that stand where the map has free floor,"""
    gone: Count
    """and things of the map that are not there any more."""
    oldest_since: Seconds | None = None
    """UTC seconds when the oldest of them was first seen; null without any."""


class CandidatePart(Part):
    """One of the places where the robot may be."""

    x: float
    y: float
    theta: Angle
    odds: Share
    """What all candidates lack to 1 is for a place that is none of them."""


class _Message(Payload):
    robot: Name
    seq: Count
    """+1 each message of its kind since the daemon's start."""
    stamp: Seconds
    """UTC seconds since 1970 of the instant for which the content is true."""

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Raises WireError, one line, for anything that is not such a message."""
        message = super().decode(payload)
        if "v" not in message.model_fields_set:
            raise WireError(f"{cls.kind}: v: the schema version is missing")
        return message


class PoseMessage(_Message):
    """``<prefix>/<robot>/pose``: where the robot is, and what that is worth."""

    kind: ClassVar[str] = "pose"
    age_s: Seconds
    """Age of the newest wheel sample in the estimate."""
    map: Uuid | None
    """UUID of the map whose frame this is; null before there is a map."""
    epoch: Count
    """+1 whenever poses jump: relocalized, new map, pose set."""
    x: float
    y: float
    theta: Angle
    vx: float
    omega: float
    covariance: Annotated[tuple[float, ...], Len(9, 9)]
    """Of (x, y, theta) in the map frame, row-major."""
    error95_m: Annotated[float, Ge(0)]
    state: State
    since_fix_s: Seconds
    since_fix_m: Annotated[float, Ge(0)]
    odom: OdomPose
    fault: Text | None
    epoch_delta: EpochDelta | None = None
    """What the pose jumped by when this epoch began; null in the first one."""
    every: Annotated[int, Ge(1)] = 1
    """``seq`` goes up by so many from message to message on this key."""


class StatusMessage(_Message):
    """``<prefix>/<robot>/status``: how the robot's localization is doing."""

    kind: ClassVar[str] = "status"
    state: State
    mode: Literal["mapping", "localization"]
    map: MapPart | None
    scanners: Annotated[dict[Name, HealthPart], Len(0, 16)]
    wheels: HealthPart
    slam: HealthPart
    """The SLAM process: its pulse, poses per second, crashes."""
    outcomes: Annotated[dict[Name, Count], Len(0, 32)] = Field(default_factory=dict)
    """What became of the samples so far: accepted, gated, late, ... (samples.Outcome)."""
    commands: Annotated[dict[Name, Count], Len(0, 8)] = Field(default_factory=dict)
    """What became of the commands so far: done, refused (by the robot), invalid (no such command,
    arguments that are none, too large), busy (too many)."""
    clock_steps: Count = 0
    """Steps of the UTC clock since the start; stamps moved with them, the estimate did not."""
    version: Name
    """Of the software."""
    uptime_s: Seconds
    cpu_percent: Annotated[float, Ge(0)]
    """Of one core, all processes of the daemon together."""
    memory_mb: Annotated[float, Ge(0)]
    fault: Text | None = None
    candidates: Annotated[tuple[CandidatePart, ...], Len(0, MAX_CANDIDATES)] = ()
    """``ambiguous``: the places that fit, best first, as of the newest pose."""
    explained: Share | None = None
    """Share of the newest registered scan that lies on the map's walls; null before the first."""

    calibration: CalibrationPart | None = None
    """What was learned of the wheels; null before the first wheel sample."""
    advice: Text | None = None
    """No fault, but something for people to do: wheels that are not as configured any more."""
    slips: Annotated[tuple[SlipPart, ...], Len(0, MAX_SLIPS)] = ()
    """The last times that wheels and scans disagreed, newest last."""
    refused_requests: Count = 0
    """Commands in other forms than ``cmd/*`` (ROS 2) that were not done: no reply tells of it."""
    changes: ChangesPart | None = None
    """Localization: how much has changed; null where nothing is watched."""
    shadow: ShadowPart | None = None
    """The camera system beside it; null where none is configured."""

    def health(self) -> Mapping[str, HealthPart]:
        """Every part's health by the name that a technician knows it by."""
        return {**self.scanners, "wheels": self.wheels, "slam": self.slam}


class ScanMessage(_Message):
    """``<prefix>/<robot>/scan``: what the scanners saw, for pictures. Not for measuring: thinned
    out and rounded."""

    kind: ClassVar[str] = "scan"
    map: Uuid | None
    """UUID of the map whose frame the points are in; null before there is a map."""
    epoch: Count
    """Of the pose by which the points were put there."""
    points: Annotated[tuple[tuple[_Coordinate, _Coordinate], ...], Len(0, MAX_SCAN_POINTS)]
    """(x, y) in m in the map frame."""

    def thinned(self, most: int) -> ScanMessage:
        """The same with ``most`` points at most (1 or more): every k-th, in their order."""
        every = -(-len(self.points) // most)
        return self if every <= 1 else self.model_copy(update={"points": self.points[::every]})


class MapImage(Payload):
    """Where the PNG of ``<prefix>/<robot>/map/image`` lies in the map frame. Its attachment."""

    kind: ClassVar[str] = "map_image"
    map: Uuid
    """UUID, as in the pose message."""
    width_px: _Pixels
    height_px: _Pixels
    metres_per_px: Annotated[float, Gt(0)]
    column_of_x0_px: float
    """Column of x = 0 m; columns grow with x."""
    row_of_y0_px: float
    """Row of y = 0 m; rows grow against y."""
