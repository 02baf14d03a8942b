"""What the robots of a scene say that need a look, and what one has seen change."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

from amr_slam.geometry import Pose2
from amr_slam.samples import State
from amr_slam.wire import CandidatePart, ChangePart, HealthPart

WELL: Final = HealthPart(link="OK", age_s=0.04, rate_hz=12.5, samples=1000, errors=0)

At = Callable[[float], Pose2]
"""The pose after so many metres of a round."""


def changed(at: At, length_m: float) -> tuple[ChangePart, ...]:
    """A box that went two days ago, and one that came an hour ago, beside the way of the robots."""
    # What, at which share of the round, how far to the left of it, its side, and since when.
    things: tuple[tuple[Literal["gone", "new"], float, float, float, float], ...] = (
        ("gone", 0.913, -1.16, 0.8, 50.0),
        ("new", 0.59, 1.0, 0.7, 1.0),
    )
    parts = []
    for number, (what, share, left_m, side_m, hours) in enumerate(things, start=1):
        pose = at(share * length_m) @ Pose2(0.0, left_m, 0.0)
        low, high = pose.translation - 0.5 * side_m, pose.translation + 0.5 * side_m
        since = time.time() - 3600.0 * hours
        box = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        part = ChangePart(number=number, what=what, box=box, since=since, seen=since, passes=3)
        parts.append(part)
    return tuple(parts)


def troubled(at: At, length_m: float) -> tuple[Mapping[str, Any], ...]:
    """What the first robots of a scene say: one that is well, and some that need a look."""
    lost = WELL.model_copy(
        update={"link": "LOST", "age_s": 42.0, "rate_hz": 0.0, "detail": "no data for 42 s"}
    )
    other = at(0.6 * length_m)
    place = CandidatePart(x=other.x_m, y=other.y_m, theta=other.theta_rad, odds=0.38)
    return (
        {"changes": changed(at, length_m)},
        {
            "state": State.ODOMETRY_ONLY, "sigma_m": 0.16, "since_fix_s": 8.2, "explained": 0.41,
            "scanners": {"front": lost, "rear": WELL}, "fault": "front: no data for 42 s",
        },
        {"state": State.AMBIGUOUS, "sigma_m": 0.3, "candidates": (place,), "explained": 0.88},
        {"state": State.LOST, "sigma_m": 0.8, "since_fix_s": 95.0, "explained": 0.12},
    )  # fmt: skip
