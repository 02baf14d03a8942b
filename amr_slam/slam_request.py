"""What the SLAM engine is asked, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field

from amr_slam.arrangement import View
from amr_slam.changes import Change
from amr_slam.clouds import Cloud
from amr_slam.evidence import Answer
from amr_slam.geometry import Array, Pose2
from amr_slam.inspection import Inspection
from amr_slam.living import ChangeCounts
from amr_slam.region import Region
from amr_slam.samples import Motion, SlamPose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlamRequest:
    """One instant's cloud and what the fusion knows of the pose there."""

    cloud: Cloud
    map_from_base: Pose2 | None
    """Expected pose; None: anywhere."""
    covariance: Array | None
    """(3, 3) of the expected pose."""
    also: Array | None = None
    """(k, 3) poses to try beside what a search everywhere finds: where earlier scans said that
    the robot may be, moved on by the wheels."""
    views: tuple[View, ...] = ()
    """The scanners that saw the cloud; without them their mounting is not questioned."""
    motion: Motion | None = None
    """What the wheels say since the last scan that was registered; None where they do not know."""
    region: Region | None = None
    """Localization: seek the pose here, whatever is expected."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlamResult:
    """The answer to one request."""

    stamp_ns: int
    answer: Answer
    climbed: tuple[Answer, ...]
    """What each rung of the ladder found, in the order they were climbed, ``answer`` included."""
    fix: SlamPose | None
    """Present where the answer is accepted."""
    inserted: bool
    """The scan became part of the map."""
    map_scans: int
    change: Change | None = None
    """Localization: the scan against the map at the answer's pose, or where nothing was accepted
    at the best one near the expected pose."""
    inspection: Inspection = field(default_factory=Inspection)
    """What the scan says of the scanners' mounting. Where it looks wrong there is no fix."""
    sought: bool = False
    """The answer is that of a search in the request's region."""
    moved: Pose2 | None = None
    """Mapping: a loop was closed. What takes the robot's pose in the map of before, of which
    ``fix`` speaks, to that in the map of now."""
    zone: str | None = None
    """The scan lies in a zone without landmarks, of this name: nothing was sought."""
    map_error_m: float = 0.0
    """How far the map's walls may lie from where it has them: an error that all fixes share."""
    joined_at: tuple[Pose2, Array] | None = None
    """``inserted``: pose and covariance (3, 3) with which the scan joined the map of before."""
    changes: ChangeCounts | None = None
    """Localization: what has been watched of the map's changes; None where nothing is watched."""
