"""Messages as they leave the robot, the keys they leave on, and the session's settings.

JSON in UTF-8, SI units, radians, finite numbers only. Each message carries the schema version
``v``; fields may be added within a version, so readers ignore those they do not know. What comes
from the network is bounded in size before it is parsed (:data:`MAX_MESSAGE_BYTES`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from annotated_types import Ge, Gt, Interval, Le, Len
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from amr_slam.geometry import Pose2
from amr_slam.samples import Candidate, Health, PoseEstimate, State

SCHEMA_VERSION: Final = 1
MAX_MESSAGE_BYTES: Final = 64 * 1024
"""Larger payloads are refused unread (reliability row 29)."""
UNKNOWN: Final = 1e9
"""Stands for "none yet" in ``since_fix_s``, ``since_fix_m`` and ``error95_m``. JSON has no
infinity, and null would pass as 0 in a careless ``error95_m < 0.1``."""

MAX_SCAN_POINTS: Final = 1500
"""Of one scan message: below MAX_MESSAGE_BYTES with millimetres."""
MAX_MAP_BYTES: Final = 64 << 20
MAX_COMMAND_BYTES: Final = 4096
"""Of a command's arguments."""

MAX_CANDIDATES: Final = 5
"""Places that a status message tells at most."""

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Where a robot listens and a tool on the same machine looks, unless told otherwise."""


class WireError(ValueError):
    """A payload that is no message of ours: too large, no JSON, wrong fields."""


def _prefix(prefix: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", prefix):
        raise ValueError("should be names of letters, digits, '_', '-' or '.', joined by '/'")
    return prefix


def _endpoint(endpoint: str) -> str:
    if not re.fullmatch(r"[a-z][a-z0-9-]*/[!-~]+", endpoint):
        raise ValueError(f"should be PROTOCOL/ADDRESS, such as {DEFAULT_ENDPOINT}")
    return endpoint


Endpoint = Annotated[str, AfterValidator(_endpoint)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohSettings:
    """How a robot takes part in the Zenoh network."""

    prefix: Annotated[str, Len(1, 128), AfterValidator(_prefix)] = "amr"
    """First part of every key: ``<prefix>/<robot>/pose``. One per fleet."""
    listen: Annotated[tuple[Endpoint, ...], Len(0, 16)] = (DEFAULT_ENDPOINT,)
    """Endpoints that accept connections, as ``tcp/ADDRESS:PORT``. Loopback unless opened up: who
    can connect can read the poses and, without access control, send commands."""
    connect: Annotated[tuple[Endpoint, ...], Len(0, 16)] = ()
    """Routers to connect to. Absent ones are tried for ever in the background."""
    keys: Path | None = None
    """Folder that ``amr-slam keys robot`` wrote: who the robot is, and whom it trusts. Without it
    nothing is encrypted, and whoever reaches an endpoint is let in."""
    multicast_scouting: bool = False
    """Find each other by multicast: handy on a desk, noise on a vehicle network."""
    scan_points: Annotated[int, Interval(ge=0, le=MAX_SCAN_POINTS)] = 360
    """Points of each registered scan that go out under ``scan``, evenly over what was seen; 0
    publishes no scans."""
    lease_ms: Annotated[int, Interval(ge=100, le=1000)] = 1000
    """A frozen robot's ``alive`` token falls after this time in ms; at most 1 s (contract)."""


def _file_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
        raise ValueError("should be 1 to 64 letters, digits, '_', '-' or '.', no such sign first")
    return name


def _reason(reason: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", reason):
        raise ValueError("should be 1 to 40 letters, digits, '_' or '-'")
    return reason


def robot_key(prefix: str, robot: str, leaf: str) -> str:
    """The key (expression) of one of a robot's topics: ``pose``, ``status`` or ``alive``."""
    return f"{prefix}/{robot}/{leaf}"


def robot_of(key: str) -> str:
    """The robot's name in a key made by :func:`robot_key`."""
    return key.rsplit("/", 2)[-2]


Text = Annotated[str, Len(0, 500)]
Name = Annotated[str, Len(1, 128)]
Seconds = Annotated[float, Ge(0)]
Count = Annotated[int, Ge(0)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Angle = Annotated[float, Gt(-math.pi), Le(math.pi)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False, strict=True, extra="ignore")


class OdomPose(_Part):
    """The pose by the wheels alone since the start: drifts, never jumps."""

    x: float
    y: float
    theta: Angle


class HealthPart(_Part):
    """One device's or process's health."""

    link: Literal["OK", "STALE", "LOST"]
    age_s: Seconds | None
    """Since the last good sample; null before the first."""
    rate_hz: Annotated[float, Ge(0)]
    samples: Count
    errors: Count
    detail: Text | None = None

    @classmethod
    def of(cls, health: Health) -> HealthPart:
        return cls.model_validate({**asdict(health), "link": health.link.name})


class MapPart(_Part):
    """Which map is active."""

    id: Annotated[str, Len(36, 36)]
    """UUID, as in the pose message."""
    name: Name
    version: Count


class CandidatePart(_Part):
    """One of the places where the robot may be."""

    x: float
    y: float
    theta: Angle
    odds: Share
    """What all candidates lack to 1 is for a place that is none of them."""

    @classmethod
    def of(cls, candidate: Candidate) -> CandidatePart:
        pose = candidate.map_from_base
        return cls(x=pose.x_m, y=pose.y_m, theta=pose.theta_rad, odds=candidate.odds)


class _Message(_Part):
    kind: ClassVar[str]
    v: Literal[1] = SCHEMA_VERSION
    robot: Name
    seq: Count
    """+1 each message of its kind since the daemon's start."""
    stamp: Annotated[float, Ge(0)]
    """UTC seconds since 1970 of the instant for which the content is true."""

    def encode(self) -> bytes:
        """JSON in UTF-8. Raises WireError when it would be refused by :meth:`decode`."""
        payload = self.model_dump_json().encode()
        if len(payload) > MAX_MESSAGE_BYTES:
            raise WireError(f"{self.kind}: {len(payload)} bytes, at most {MAX_MESSAGE_BYTES}")
        return payload

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Raises WireError, one line, for anything that is not such a message."""
        if len(payload) > MAX_MESSAGE_BYTES:
            raise WireError(f"{cls.kind}: {len(payload)} bytes, at most {MAX_MESSAGE_BYTES}")
        try:
            message = cls.model_validate_json(payload)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise WireError(f"{cls.kind}: {where or 'payload'}: {first['msg']}") from error
        if "v" not in message.model_fields_set:
            raise WireError(f"{cls.kind}: v: the schema version is missing")
        return message


class PoseMessage(_Message):
    """``<prefix>/<robot>/pose``: where the robot is, and what that is worth."""

    kind: ClassVar[str] = "pose"
    age_s: Seconds
    """Age of the newest wheel sample in the estimate."""
    map: Annotated[str, Len(36, 36)] | None
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

    @classmethod
    def from_estimate(
        cls,
        estimate: PoseEstimate,
        *,
        robot: str,
        seq: int,
        utc_from_monotonic_ns: int,
        map_id: str | None,
    ) -> PoseMessage:
        """``utc_from_monotonic_ns`` + the estimate's stamp is UTC in ns. Raises ValueError when
        the pose, its covariance or a speed is not finite: nothing is repaired on the way out."""
        pose, odom = estimate.map_from_base, estimate.odom_from_base
        utc_ns = estimate.stamp_ns + utc_from_monotonic_ns
        return cls(
            robot=robot,
            seq=seq,
            stamp=utc_ns / 1_000_000_000,  # by an int: ns above 2^53 would be rounded twice
            age_s=estimate.wheel_age_s,
            map=map_id,
            epoch=estimate.epoch,
            x=pose.x_m,
            y=pose.y_m,
            theta=pose.theta_rad,
            vx=estimate.vx_mps,
            omega=estimate.omega_radps,
            covariance=tuple(estimate.covariance.ravel().tolist()),
            error95_m=min(estimate.error95_m, UNKNOWN),
            state=estimate.state,
            since_fix_s=min(estimate.since_fix_s, UNKNOWN),
            since_fix_m=min(estimate.since_fix_m, UNKNOWN),
            odom=OdomPose(x=odom.x_m, y=odom.y_m, theta=odom.theta_rad),
            fault=estimate.fault,
        )

    @property
    def map_from_base(self) -> Pose2:
        return Pose2(self.x, self.y, self.theta)


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
    outcomes: Annotated[dict[Name, Count], Len(0, 32)] = {}
    """What became of the samples so far: accepted, gated, late, ... (samples.Outcome)."""
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

    def health(self) -> Mapping[str, HealthPart]:
        """Every part's health by the name that a technician knows it by."""
        return {**self.scanners, "wheels": self.wheels, "slam": self.slam}


class ScanMessage(_Message):
    """``<prefix>/<robot>/scan``: the points of one registered scan, for pictures."""

    kind: ClassVar[str] = "scan"
    map: Annotated[str, Len(36, 36)] | None
    epoch: Count
    points: Annotated[tuple[tuple[float, float], ...], Len(0, MAX_SCAN_POINTS)]
    """(x, y) in m, in the map frame."""


class _Arguments(BaseModel):
    """Of a command; unlike in messages, what is unknown is refused: it may be a slip."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False, strict=True, extra="forbid")
    kind: ClassVar[str]

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Raises WireError, one line, for anything but these arguments."""
        if len(payload) > MAX_COMMAND_BYTES:
            raise WireError(f"{len(payload)} bytes, at most {MAX_COMMAND_BYTES}")
        try:
            return cls.model_validate_json(payload or b"{}")
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise WireError(f"{where or 'arguments'}: {first['msg']}") from error


Coordinate = Annotated[float, Interval(ge=-1e5, le=1e5)]
MapName = Annotated[str, AfterValidator(_file_name)]


class _Pose(_Arguments):
    x: Coordinate
    y: Coordinate
    theta: Angle


class ResumePose(_Pose):
    """The robot is exactly here: taken as is."""

    kind: ClassVar[str] = "resume_pose"


class SetPose(_Pose):
    """The robot is about here: searched."""

    kind: ClassVar[str] = "set_pose"
    radius: Annotated[float, Interval(ge=0.1, le=10000.0)]


class Relocalize(_Arguments):
    """Forget the pose."""

    kind: ClassVar[str] = "relocalize"


class StartMapping(_Arguments):
    """Begin a new map where the robot stands."""

    kind: ClassVar[str] = "start_mapping"
    name: MapName


class SaveMap(_Arguments):
    """Save the active map under a name."""

    kind: ClassVar[str] = "save_map"
    name: MapName


class LoadMap(_Arguments):
    """Localize in a saved map."""

    kind: ClassVar[str] = "load_map"
    name: MapName


class SaveRecording(_Arguments):
    """Save what was recorded last."""

    kind: ClassVar[str] = "save_recording"
    reason: Annotated[str, AfterValidator(_reason)]


Command = ResumePose | SetPose | Relocalize | StartMapping | SaveMap | LoadMap | SaveRecording
COMMANDS: Final[Mapping[str, type[Command]]] = {
    kind.kind: kind
    for kind in (SetPose, ResumePose, Relocalize, StartMapping, SaveMap, LoadMap, SaveRecording)
}


class FoundPose(_Part):
    """Where a command has put the robot."""

    x: float
    y: float
    theta: Angle


class CommandReply(_Part):
    """What became of a command."""

    v: Literal[1] = SCHEMA_VERSION
    ok: bool
    error: Text | None = None
    pose: FoundPose | None = None
    map: MapPart | None = None
    file: Text | None = None

    def encode(self) -> bytes:
        return self.model_dump_json().encode()

    @classmethod
    def refusing(cls, error: Exception | str) -> CommandReply:
        return cls(ok=False, error=" ".join(str(error).split())[:500] or "failed")


class MapImage(_Part):
    """Where the picture of the map lies."""

    v: Literal[1] = SCHEMA_VERSION
    map: Annotated[str, Len(36, 36)]
    width_px: int
    height_px: int
    metres_per_px: float
    column_of_x0_px: float
    row_of_y0_px: float

    def encode(self) -> bytes:
        return self.model_dump_json().encode()


def command_of(name: str, payload: bytes) -> Command:
    """The command with its arguments. Raises WireError, one line."""
    if name not in COMMANDS:
        raise WireError(f"{name:.40}: no such command; there are {', '.join(COMMANDS)}")
    return COMMANDS[name].decode(payload)


def json_schemas() -> dict[str, dict[str, Any]]:
    """JSON Schema of each message by its topic."""
    return {message.kind: message.model_json_schema() for message in (PoseMessage, StatusMessage)}
