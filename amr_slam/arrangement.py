"""What may be wrong with how the scanners are mounted, as changes of the clouds that they gave.

A scanner that is mounted otherwise than configured still measures well: its points are right up
to a turn, a reflection or a shift. Undo it, and they fit again: that names the fault.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2, readonly

_FLIP: Final = np.diag([1.0, -1.0, 1.0])
_TURNS_DEG: Final = (180.0, 90.0, -90.0)
_ALIKE: Final = 0.1
"""Two changes of the base frame that differ by less (m, rad) are one and the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """One scanner of a cloud, as it is configured."""

    scanner: str
    base_from_lidar: Pose2
    upside_down: bool = False
    base_from_then: Pose2 = field(default_factory=Pose2.identity)
    """Where the base stood when this scanner measured, in that of the cloud's instant."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rearrangement:
    """A fault, and how the clouds would lie without it."""

    name: str
    """For people."""
    changes: Array
    """(scanners, 3, 3) read-only homogeneous: from where each scanner's points seem to be to
    where they are, in the base frame of the instant in which it measured."""
    right_from_seen: Array
    """(scanners, 3, 3) read-only: the same in the base frame of the cloud."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "changes", readonly(self.changes))
        object.__setattr__(self, "right_from_seen", readonly(self.right_from_seen))

    @property
    def common(self) -> Array | None:
        """(3, 3) where one change of the base frame is all that is wrong: then a single scan
        fits as well as ever, at another pose or in a mirrored map. Else None."""
        first, *others = self.changes
        alike = all(np.abs(other - first).max() < _ALIKE for other in others)
        return np.asarray(first) if alike else None

    @property
    def is_rigid(self) -> bool:
        """Whether the fault looks like another pose of the robot: only motion tells."""
        common = self.common
        return common is not None and bool(np.linalg.det(common) > 0.0)

    def apply(self, cloud: Cloud) -> Cloud:
        """The cloud as it would be without the fault."""
        change = self.right_from_seen[cloud.scanners]
        turn, shift = change[:, :2, :2], change[:, :2, 2]

        def moved(points: Array) -> Array:
            return np.asarray(np.einsum("nij,nj->ni", turn, points) + shift)

        return replace(
            cloud,
            points_m=moved(cloud.points_m),
            normals=np.einsum("nij,nj->ni", turn, cloud.normals),
            origins_m=moved(cloud.origins_m),
            scanners=cloud.scanners.copy(),
        )

    def true_base(self, scanner: int) -> Pose2 | None:
        """``seen_from_right`` of one scanner: where the robot is, in the frame of a robot that
        trusts this scanner alone; None where the scanner is mirrored."""
        change = self.right_from_seen[scanner]
        return pose_of(np.linalg.inv(change)) if np.linalg.det(change) > 0.0 else None


def rearrangements(views: Sequence[View]) -> list[Rearrangement]:
    """All faults that are looked for."""
    then = [matrix(view.base_from_then) for view in views]
    return [
        Rearrangement(
            name=name,
            changes=np.array(changes),
            right_from_seen=np.array(
                [at @ change @ np.linalg.inv(at) for at, change in zip(then, changes, strict=True)]
            ),
        )
        for name, changes in _faults(views)
    ]


def _faults(views: Sequence[View]) -> Iterator[tuple[str, list[Array]]]:
    """(name, the change of each scanner)."""
    mirrored = [_mirrored(view) for view in views]
    for row, view in enumerate(views):
        flag = "false" if view.upside_down else "true"
        yield (
            f"{view.scanner} scanner looks mirrored: upside_down = {flag}?",
            _one(views, row, mirrored[row]),
        )
        for turn_deg in _TURNS_DEG:
            turned = _turned(view.base_from_lidar, math.radians(turn_deg))
            yield (
                f"{view.scanner} scanner looks turned by {turn_deg:g} deg",
                _one(views, row, turned),
            )
    if len(views) == 1:
        return
    names = " and ".join(view.scanner for view in views)
    yield f"{names} scanner look mirrored: upside_down?", mirrored
    for a, b in itertools.combinations(range(len(views)), 2):
        yield f"{views[a].scanner} and {views[b].scanner} look swapped", _swapped(views, a, b)
    half = np.diag([-1.0, -1.0, 1.0])
    yield "all scanners look turned by 180 deg: ahead is behind", [half] * len(views)


def matrix(pose: Pose2) -> Array:
    """(3, 3) homogeneous."""
    out = np.eye(3)
    out[:2, :2], out[:2, 2] = pose.rotation, pose.translation
    return out


def pose_of(homogeneous: Array) -> Pose2:
    """The pose of a homogeneous matrix (3, 3) without reflection."""
    theta = math.atan2(homogeneous[1, 0], homogeneous[0, 0])
    return Pose2(float(homogeneous[0, 2]), float(homogeneous[1, 2]), theta)


def seen_motion(delta: Pose2, common: Array) -> Pose2:
    """How a robot whose base frame is changed by ``common`` (3, 3) sees its motion ``delta``."""
    return pose_of(np.linalg.inv(common) @ matrix(delta) @ common)


def _one(views: Sequence[View], row: int, change: Array) -> list[Array]:
    return [change if other == row else np.eye(3) for other in range(len(views))]


def _mirrored(view: View) -> Array:
    mounted = matrix(view.base_from_lidar)
    return np.asarray(mounted @ _FLIP @ np.linalg.inv(mounted))


def _turned(base_from_lidar: Pose2, turn_rad: float) -> Array:
    turn = Pose2(0.0, 0.0, turn_rad)
    return matrix(base_from_lidar @ turn @ base_from_lidar.inverse())


def _swapped(views: Sequence[View], a: int, b: int) -> list[Array]:
    changes = [np.eye(3) for _ in views]
    flip = _FLIP if views[a].upside_down != views[b].upside_down else np.eye(3)
    for here, there in ((a, b), (b, a)):
        mounted, true = (matrix(views[row].base_from_lidar) for row in (here, there))
        changes[here] = true @ flip @ np.linalg.inv(mounted)
    return changes
