"""What a commissioning report is made with: how densely it looks, and what counts as good."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le

from amr_slam.commissioning.viewing import Eye
from amr_slam.simulation import SCANNERS, opposite_scanners


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportParams:
    """Numbers of poses bound the time; none of them depends on a clock, so that the same map gives
    the same report."""

    seed: Annotated[int, Ge(0)] = 0
    """Of headings and of the noise of the simulated scans."""
    cold_starts: Annotated[int, Ge(10), Le(5000)] = 240
    """Poses, evenly over the floor, at which the robot is switched on without knowing where."""
    suspects: Annotated[int, Ge(0), Le(5000)] = 80
    """More such poses, where the signatures say that another place looks the same."""
    precision_places: Annotated[int, Ge(10), Le(20_000)] = 1500
    """Places, evenly over the floor, at which the expected error is worked out."""
    pairs_tried: Annotated[int, Ge(0)] = 4
    """Look-alike pairs, the largest first, for which boxes are tried."""
    corridors_tried: Annotated[int, Ge(0)] = 2
    """Weakly constrained areas, the largest first, for which boxes are tried."""
    boxes_tried: Annotated[int, Ge(1)] = 6
    """Places of a box that are tried for each of them."""
    poses_a_box: Annotated[int, Ge(2)] = 16
    """Poses at which each is tried; the best one then at all."""

    good_m: Annotated[float, Gt(0.0)] = 0.05
    """An expected error up to this is good: enough to drive and to hand over a load."""
    poor_m: Annotated[float, Gt(0.0)] = 0.2
    """One above this is poor: more than the free space that most aisles leave."""
    seen_often: Annotated[int, Ge(1)] = 3
    """Floor that so many scans passed over is known well: one scan may show a passer-by."""
    right_m: Annotated[float, Gt(0.0)] = 0.25
    """A cold start within this and the following is right."""
    right_rad: Annotated[float, Gt(0.0)] = math.radians(5.0)
    alike: Annotated[float, Gt(0.0), Le(1.0)] = 0.1
    """A place with this share of the best one's odds is a rival of it."""


def usual_eyes() -> tuple[Eye, ...]:
    """Two scanners of 270 degrees at opposite corners, where no configuration says otherwise."""
    return tuple(Eye.of(model) for model in opposite_scanners(SCANNERS["S300"]))
