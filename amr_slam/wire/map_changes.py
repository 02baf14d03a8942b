"""What has changed in a place since its map was made, as the robot has watched it."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final, Literal

from annotated_types import Ge, Len

from amr_slam.wire.values import Count, Part, Payload, Seconds, Uuid

MAX_CHANGES: Final = 350
"""Things that are told at most: with places in mm within 100 km they fit into a message."""


class ChangePart(Part):
    """One thing that is new or gone."""

    number: Annotated[int, Ge(1)]
    """The oldest is 1: ``amr-slam map diff`` counts alike."""
    what: Literal["new", "gone"]
    box: Annotated[tuple[float, ...], Len(4, 4)]
    """x_min, y_min, x_max, y_max in m in the map frame."""
    since: Seconds | None
    """UTC seconds when it was first seen so; null where nobody knows,"""
    seen: Seconds | None
    """and when last."""
    passes: Count | None
    """Passes in a row that have shown it."""


class MapChanges(Payload):
    """Answer of ``<prefix>/<robot>/map/changes``."""

    kind: ClassVar[str] = "map_changes"
    map: Uuid
    """UUID, as in the pose message."""
    total: Count
    """Things there are: of more than :data:`MAX_CHANGES` the largest are told."""
    changes: Annotated[tuple[ChangePart, ...], Len(0, MAX_CHANGES)]
    """By their numbers."""
