"""Drives by name: a table, and plug-ins from other distributions by entry point.

A plug-in names a frozen dataclass of numbers with the methods of :class:`Odometry` under
``amr_slam.drives``::

    [project.entry-points."amr_slam.drives"]
    mecanum = "acme_amr.mecanum:MecanumDrive"

Its fields are then the keys of ``[drive]`` beside ``kind = "mecanum"``.
"""

from __future__ import annotations

from dataclasses import is_dataclass
from importlib.metadata import entry_points
from typing import Final, cast

from amr_slam.odometry.differential import DifferentialDrive
from amr_slam.odometry.poses import PoseOdometry
from amr_slam.odometry.protocol import Odometry
from amr_slam.odometry.tricycle import TricycleDrive

_GROUP: Final = "amr_slam.drives"


def drive_kinds() -> dict[str, type[Odometry]]:
    """Every drive that ``drive.kind`` may name. Raises ValueError for an unusable plug-in."""
    kinds: dict[str, type[Odometry]] = {
        "differential": DifferentialDrive,
        "tricycle": TricycleDrive,
        "poses": PoseOdometry,
    }
    for point in entry_points(group=_GROUP):
        try:
            drive = point.load()
        except (ImportError, AttributeError) as error:
            raise ValueError(f"drive {point.name!r} cannot be loaded: {error}") from error
        missing = [name for name in ("joints", "motion", "silence") if not hasattr(drive, name)]
        if not (isinstance(drive, type) and is_dataclass(drive)) or missing:
            what = f"has no {missing[0]}" if missing else "is no dataclass"
            raise ValueError(f"drive {point.name!r}: {point.value} {what}")
        kinds[point.name] = cast("type[Odometry]", drive)
    return kinds
