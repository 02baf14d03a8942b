"""What flows through the program: measurements in, poses out, and the two device protocols.

All stamps are nanoseconds of one monotonic clock (``time.monotonic_ns()`` in the daemon, the
log's own clock in a replay). Wall time exists only in :mod:`amr_slam.wire`.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np

from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.states import State as State  # noqa: PLC0414 - part of an estimate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scan:
    """One sweep of one scanner.

    Beam ``i`` looks along ``angle_min_rad + i * angle_step_rad`` in the lidar frame
    (counter-clockwise, 0 = straight ahead) at ``stamp_ns + i / (n - 1) * sweep_s``.
    """

    scanner: str
    """Name of the scanner in the configuration or the log."""
    stamp_ns: int
    """Instant of the first beam."""
    ranges_m: Array
    """(n,) read-only. +inf: nothing within range ("no return"). NaN: no measurement."""
    angle_min_rad: float
    angle_step_rad: float
    sweep_s: float = 0.0
    """Time from the first beam to the last; 0 where the source does not tell."""
    range_max_m: float = math.inf
    seq: int | None = None
    """The device's own scan counter, where it has one."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "ranges_m", readonly(self.ranges_m))

    @property
    def angles_rad(self) -> Array:
        """(n,) beam angles in the lidar frame."""
        beams = np.arange(len(self.ranges_m), dtype=np.float64)
        return self.angle_min_rad + self.angle_step_rad * beams

    @property
    def mid_stamp_ns(self) -> int:
        """Middle of the sweep: the instant for which the scan's pose is estimated."""
        return self.stamp_ns + round(0.5e9 * self.sweep_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSample:
    """Both wheels' angles at one instant, summed since the source was opened (never wrapped)."""

    stamp_ns: int
    left_rad: float
    """Rotation of the left wheel, forward positive."""
    right_rad: float
    segment: int = 0
    """+1 whenever continuity is lost (gap, encoder reset): never integrate across segments."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSample:
    """The joints of any other drive at one instant: wheels that roll, axles that steer.

    Raises ValueError when there is not one angle for each name.
    """

    stamp_ns: int
    names: tuple[str, ...]
    """As the drive calls them, in its order: ``("drive", "steer")``."""
    angles_rad: tuple[float, ...]
    """One for each name. Rolling: summed since the source was opened, forward positive, never
    wrapped. Steering: the angle itself, counter-clockwise positive."""
    segment: int = 0
    """As in :class:`WheelSample`."""

    def __post_init__(self) -> None:
        if len(self.names) != len(self.angles_rad):
            raise ValueError(f"{len(self.angles_rad)} angles for {len(self.names)} joints")


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometrySample:
    """A pose that somebody else integrated from the wheels (logs, drives with own odometry)."""

    stamp_ns: int
    odom_from_base: Pose2
    segment: int = 0


DriveSample = WheelSample | JointSample | OdometrySample
"""What an odometry source may give."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """What the wheels say about one interval: the base frame's own displacement."""

    start_ns: int
    end_ns: int
    delta: Pose2
    """``start_from_end`` of the base frame."""
    covariance: Array
    """(3, 3) read-only: of delta's (x, y, theta) in the end's frame, body (right) perturbation."""
    gap: bool = False
    """True: the wheels could not tell; the covariance says what may have been, delta nothing."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", readonly(self.covariance))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlamPose:
    """A pose that the registration found for one scan, true for ``stamp_ns``."""

    stamp_ns: int
    map_from_base: Pose2
    covariance: Array
    """(3, 3) read-only, of (x, y, theta) in the map frame."""
    relocalized: bool = False
    """True: found without the prior (a jump is meant), not a correction of it."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", readonly(self.covariance))


class Way(enum.StrEnum):
    """Which way raw bytes went."""

    RECEIVED = "received"
    SENT = "sent"
    GAP = "gap"
    """No bytes: what came before them and what comes after them do not belong together."""
    OPENED = "opened"
    """No bytes: the driver is being opened (anew); what it knew of the device begins here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RawBytes:
    """What a device's line carried in one piece: a read of a stream, a datagram, a request.

    In the order in which a driver's decoder got them they give the same scans again.
    """

    device: str
    """Name in the configuration."""
    stamp_ns: int
    """When the piece was received or sent."""
    way: Way
    data: bytes = b""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanFrame:
    """One CAN frame as it came over the bus, or as it shall go."""

    stamp_ns: int
    """When it was received."""
    identifier: int
    """11 or 29 bits; of an error frame its class bits."""
    data: bytes = b""
    is_extended: bool = False
    """The identifier has 29 bits, not 11."""
    is_error: bool = False
    """No data at all: the interface tells of trouble on the bus."""
    is_remote: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RawFrame(CanFrame):
    """A frame as a device's driver got it."""

    device: str
    """Name in the configuration."""


Raw = RawBytes | RawFrame

Tap = Callable[[RawBytes], object]
"""Takes a copy of all bytes that pass on a scanner's line; returns at once; any thread."""

FrameTap = Callable[[RawFrame], object]
"""The same of the frames on the wheels' bus."""

WHEELS: Final = "wheels"
"""What the odometry is called where devices are named; no scanner may have this name."""


def untapped(_raw: Raw) -> None:
    """The tap of who records nothing."""


class Outcome(enum.StrEnum):
    """What became of one sample. Everything but ACCEPTED is counted and published."""

    ACCEPTED = "accepted"
    INFLATED = "inflated"
    """Taken with a larger covariance: suspicious, not absurd."""
    GATED = "gated"
    """Refused: contradicts the estimate by more than both claim."""
    RESET = "reset"
    """The estimate jumped to it: a new epoch."""
    LATE = "late"
    """Older than the history that could take it in."""
    FUTURE = "future"
    """Stamped after the newest wheel sample by more than clocks may differ."""
    DUPLICATE = "duplicate"
    INVALID = "invalid"
    """Not finite, not positive definite, beyond physical limits."""
    FROZEN = "frozen"
    """A scan that its scanner has sent before, to the last bit."""
    MISMOUNTED = "mismounted"
    """A scan that speaks against the configuration of the scanners."""
    UNKNOWN = "unknown"
    """A scan for which no pose was found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """One of several places where the robot may be."""

    map_from_base: Pose2
    odds: float
    """How probable, in 0..1; what all candidates lack to 1 is for a place that is none of them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseEstimate:
    """The fused pose, true for ``stamp_ns``, and what it is worth."""

    stamp_ns: int
    map_from_base: Pose2
    covariance: Array
    """(3, 3) read-only, of (x, y, theta) in the map frame; exactly: of the twist from this pose to
    the true one, along the map's axes (``docs/adr/0020-errors-as-twists.md``)."""
    odom_from_base: Pose2
    """Wheels alone since the start: drifts, never jumps."""
    vx_mps: float
    omega_radps: float
    state: State
    epoch: int
    error95_m: float
    """The position error that is not exceeded in 95 % of the cases."""
    since_fix_s: float
    since_fix_m: float
    wheel_age_s: float = 0.0
    """Age of the newest wheel sample in it."""
    fault: str | None = None
    candidates: tuple[Candidate, ...] = ()
    """AMBIGUOUS: the places that fit, moved on to ``stamp_ns``, best first, five at most."""
    explained: float | None = None
    """Share of the newest registered scan that lies on the map's walls; None where none was."""
    epoch_delta: Pose2 | None = None
    """What x, y and theta jumped by when this epoch began; None in the first one."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", readonly(self.covariance))


class Link(enum.StrEnum):
    """State of a device or process as seen from outside."""

    OK = "ok"
    STALE = "stale"
    LOST = "lost"


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """One device's health. ``detail`` names what a technician can act on (standby, lock-out)."""

    link: Link
    age_s: float | None = None
    """Since the last good sample; None before the first."""
    rate_hz: float = 0.0
    samples: int = 0
    errors: int = 0
    detail: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceInfo:
    """What a device says about itself; for ``check --probe`` and the status message."""

    model: str
    address: str
    """Port, URL or channel."""
    facts: tuple[tuple[str, str], ...] = field(default=())
    """Further (name, value) pairs in the technician's words."""


class Scanner(Protocol):
    """A scanner's driver. One thread calls ``read``; ``close`` may come from another."""

    def read(self, timeout_s: float) -> Scan | None:
        """The next complete scan, or None when none came in time. Raises DriverError (LinkLost
        when the device is gone; the caller closes, waits and opens anew)."""

    def info(self) -> DeviceInfo: ...

    def status(self) -> tuple[int, str | None]:
        """(damaged telegrams so far, what hinders measuring now or None)."""

    def close(self) -> None:
        """Idempotent; a blocked ``read`` returns within 0.5 s."""


class OdometrySource(Protocol):
    """A wheel odometry driver; same rules as :class:`Scanner`."""

    def read(self, timeout_s: float) -> DriveSample | None: ...

    def info(self) -> DeviceInfo: ...

    def status(self) -> tuple[int, str | None]: ...

    def close(self) -> None: ...
