"""What daemon and SLAM process say to each other through the pipe, beside requests and results."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2
from amr_slam.living import AcceptPolicy, MapDiff
from amr_slam.params import SlamParams
from amr_slam.states import Mode


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Joined:
    """A scan that became part of a map."""

    cloud: Cloud
    map_from_base: Pose2
    covariance: Array
    """(3, 3)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamJob:
    """What the process is to do."""

    mode: Mode
    params: SlamParams
    source: Path | None
    """The map to start with; None: an empty one."""
    target: Path | None
    """Mapping: where the map is saved."""
    name: str
    """Mapping: the map's name."""
    save_period_s: float
    """Mapping: a map that changed is saved this often."""
    saved_before: bool = False
    """The file at ``target`` is this run's own, not an older map that is worth keeping."""
    hold: bool = False
    """Mapping: what is in the map at first stays as it is."""
    policy: AcceptPolicy = field(default_factory=AcceptPolicy)
    """Localization: changes that become a new version of the map by themselves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ready:
    """The map is there; requests are answered from now on."""

    map_id: str | None
    """UUID of the file's content; None for a map that begins empty."""
    map_name: str
    map_scans: int
    path: Path | None = None
    """The file that was loaded."""
    complaint: str | None = None
    """Why that is an older version of the file that was asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """There is no map to work with; the process ends."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Saved:
    """The map was written, or was not."""

    map_scans: int
    error: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Renewed:
    """The map has become a newer version of itself, in the same frame."""

    ready: Ready
    taken: int
    """Changes that it has taken in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unsaved:
    """What had joined the map since it was saved last, in a process that was lost: before the
    first request, and not answered."""

    scans: tuple[Joined, ...]


class Stop:
    """Asks the process to save and to end."""


# -- tasks, each answered once, in turn with the requests


@dataclass(frozen=True, slots=True, kw_only=True)
class Switch:
    """Save what was mapped, and go on with another job. Answered by Switched."""

    job: SlamJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Grow:
    """Let the map that is loaded grow on, by another job. Answered by Switched."""

    job: SlamJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Store:
    """Write the map as it is now. Answered by Stored."""

    target: Path | None
    """A file that does not exist yet; None: the file of the running job."""
    name: str | None = None
    """The map's name in it; None: its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """Draw the map as it is now. Answered by Drawn."""

    resolution_m: float | None
    """Side of a pixel; None: of a wall cell."""


class Compare:
    """Tell what has changed since the map was made. Answered by Compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Switched:
    """Requests are answered by the new job's map from now on."""

    job: SlamJob
    ready: Ready
    same_frame: bool = False
    """Localization, before and after, in two versions of one map: a pose in it is still true."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """The map is in a file, whole."""

    path: Path
    map_id: str
    """UUID of the file's content."""
    map_scans: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A picture and where it lies in the map frame (docs: :class:`OccupancyImage`)."""

    png: bytes
    columns: int
    rows: int
    resolution_m: float
    x_min_m: float
    y_min_m: float
    map_scans: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """All that has been watched."""

    diff: MapDiff


@dataclass(frozen=True, slots=True, kw_only=True)
class Declined:
    """A task that was not done; everything is as before."""

    reason: str


Task = Switch | Grow | Store | Draw | Compare
TaskAnswer = Switched | Stored | Drawn | Compared | Declined
