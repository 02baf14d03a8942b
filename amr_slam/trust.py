"""What an answer of the registration is worth, and when a pose is not worth driving by any more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from amr_slam.evidence import Answer, Rung
from amr_slam.fusion import Calibration, EasingParams
from amr_slam.geometry import Array
from amr_slam.hypotheses import TrackingParams

if TYPE_CHECKING:  # the configuration needs the parameters, before anything that takes a while
    from amr_slam.slam_request import SlamResult


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizerParams:
    """When scans belong together, and when a pose is no longer worth driving by."""

    pair_wait_s: Annotated[float, Ge(0.0)] = 0.15
    """How long a scan waits for the other scanner's before it is registered alone."""
    alone_inflation: Annotated[float, Ge(1.0)] = 2.0
    """Factor on the covariance of a fix that lacks one of the robot's scanners."""
    fresh_s: Annotated[float, Gt(0.0)] = 5.0
    """A fix older than this (2.5 scan periods) is not fresh: odometry_only."""
    lost_s: Annotated[float, Gt(0.0)] = 20.0
    """Without a fix for this long: lost."""
    lost_axis_m: Annotated[float, Gt(0.0)] = 1.5
    """Three standard deviations along the error ellipse's major axis above this: lost."""
    lost_heading_deg: Annotated[float, Gt(0.0), Le(180.0)] = 60.0
    """Three standard deviations of the heading above this: lost."""
    lost_refusals: Annotated[int, Ge(1)] = 5
    """This many scans in a row without an accepted pose: lost."""
    agreeing_relocalizations: Annotated[int, Ge(1)] = 2
    """Agreeing solutions of a search around the expected pose before the pose jumps to them."""
    agreeing_refusals: Annotated[int, Ge(1)] = 3
    """Refused fixes that agree with one another before the filter gives in."""
    wheels_late_s: Annotated[float, Gt(0.0)] = 0.1
    """Wheels silent for this long: said in the fault text."""
    wheels_silent_s: Annotated[float, Gt(0.0)] = 0.5
    """Wheels silent for this long: they no longer count, the robot may be anywhere it could
    have driven to."""
    wheels_lost_s: Annotated[float, Gt(0.0)] = 2.0
    """Wheels silent for this long: lost."""
    changed_share: Annotated[float, Gt(0.0), Le(1.0)] = 0.15
    """So much of the scan must contradict the map to be told as a change of the place."""
    explained_share: Annotated[float, Ge(0.0), Le(1.0)] = 0.5
    """A scan that is not accepted, but fits at the expected pose with so much of its surface, does
    not count towards ``lost``: the place has changed, the robot is where it was thought to be."""
    outage_s: Annotated[float, Gt(0.0)] = 7.0
    """Localization: after so long without a fix the first one that contradicts the wheels is
    believed."""
    slip_told_s: Annotated[float, Ge(0.0)] = 10.0
    """How long in s a slip of the wheels stands in the fault text."""
    easing: EasingParams = field(default_factory=EasingParams)
    """How corrections enter the published pose."""
    tracking: TrackingParams = field(default_factory=TrackingParams)
    """Places found by a search of the whole map."""


def too_wide(covariance: Array, params: LocalizerParams) -> bool:
    """Whether a pose of this covariance (3, 3) is no pose to drive by."""
    major_m = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    heading_rad = math.sqrt(float(covariance[2, 2]))
    return 3.0 * major_m > params.lost_axis_m or 3.0 * heading_rad > math.radians(
        params.lost_heading_deg
    )


def whole_map(result: SlamResult) -> Answer | None:
    """The most thorough answer of a search of the whole map, if there was one."""
    searched = [one for one in result.climbed if one.rung in {Rung.ABSOLUTE, Rung.EXHAUSTIVE}]
    return searched[-1] if searched else None


def scanner_fault(missing: Sequence[str], frozen: Sequence[str]) -> str | None:
    """Which scanners do not take part."""
    faults = [f"{name} scanner frozen: it sends the same scan again and again" for name in frozen]
    faults += [f"{name} scanner missing" for name in missing if name not in frozen]
    return "; ".join(faults) or None


def drift_of(known: Calibration) -> str | None:
    """What the robot has learned of its wheels that refutes the configuration by more than chance
    (four standard deviations) and by more than is worth a word."""
    said = []
    if abs(known.travel) > max(4.0 * known.travel_sigma, 0.01):
        said.append(f"the way differs by {known.travel:+.1%} from what they say")
    if abs(known.yaw) > max(4.0 * known.yaw_sigma, 0.02):
        said.append(f"turns differ by {known.yaw:+.1%} from what they say")
    if abs(known.bend_radpm) > max(4.0 * known.bend_sigma_radpm, 0.01):
        said.append(f"straight ahead bends by {math.degrees(known.bend_radpm):+.1f} deg a metre")
    if abs(known.lag_s) > max(4.0 * known.lag_sigma_s, 0.05):
        said.append(f"their clock is {1e3 * known.lag_s:+.0f} ms off the scanners'")
    return f"wheels: {'; '.join(said)}: calibrate" if said else None


def fault_of(
    result: SlamResult | None, refusals: int, wheel_age_s: float, params: LocalizerParams
) -> str | None:
    """What to tell people is wrong. ``refusals``: scans in a row that were of no use."""
    if wheel_age_s > params.wheels_late_s:
        return f"wheels silent for {wheel_age_s:.1f} s"
    if result is None or result.inserted:
        return None
    change = result.change
    changed = change is not None and change.contradicting >= params.changed_share
    if refusals or (result.fix is None and not changed):
        return result.answer.reason or "the newest scan fits, but elsewhere: slipped, or carried?"
    return f"{change.describe()}: the place has changed?" if change and changed else None
