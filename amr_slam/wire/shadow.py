"""What a robot says of the camera system beside it."""

from __future__ import annotations

from typing import Annotated, Final

from annotated_types import Ge, Gt, Len

from amr_slam.wire.values import Angle, Count, Part, Seconds, Text

MAX_SHADOW_ZONES: Final = 5
"""Zones that a status message tells at most."""

_Size = Annotated[float, Ge(0)]


class ShadowZone(Part):
    """Differences on one square of the floor."""

    x: float
    """Of its middle, in the map frame."""
    y: float
    side_m: Annotated[float, Gt(0)]
    count: Count
    rms_m: _Size
    max_m: _Size


class ShadowPart(Part):
    """Differences of a camera system's poses and the robot's own at the same instants, camera less
    robot, since ``since`` and in the active map. The camera's poses are used for nothing else."""

    key: Text
    """Where it speaks."""
    since: Seconds | None
    """UTC seconds of the first difference; null before it. Counting begins anew with another map,
    and once when the clock difference becomes known."""
    count: Count
    """Differences so far."""
    mean_m: _Size
    rms_m: _Size
    p95_m: _Size
    """Rounded up by 5 % at most."""
    max_m: _Size
    rms_rad: _Size | None
    """Of the heading; null where the cameras give none."""
    p95_rad: _Size | None
    bias_x_m: float
    """Mean difference in the map frame."""
    bias_y_m: float
    bias_rad: Angle | None
    clock_s: float
    """This was added to the camera's stamps."""
    clock_sigma_s: _Size | None
    """Standard deviation of that; null where it is not known: stamps are taken as they are."""
    zones: Annotated[tuple[ShadowZone, ...], Len(0, MAX_SHADOW_ZONES)]
    """The worst ones by their rms, worst first."""
    age_s: Seconds | None
    """Since the newest difference; null before the first."""
    received: Count
    """Messages on the key."""
    refused: Count
    """Of these no poses, ..."""
    unmatched: Count
    """... of instants for which the robot has no pose, ..."""
    unlocalized: Count
    """... or one that it says not to drive by, ..."""
    dropped: Count
    """... and too many at once."""
    detail: Text | None
    """What was wrong with the last message that was not compared, within the last 10 s."""
