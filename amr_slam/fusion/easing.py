"""Small corrections enter the published pose at a bounded speed, large ones at once.

A controller that steers by the map pose must not feel each fix as a jerk. What the pose still
lacks is a pure function of time, so that asking for a pose changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.geometry import Array, Pose2, wrap_angle

_NOTHING: Final = Pose2.identity()


@dataclass(frozen=True, slots=True, kw_only=True)
class EasingParams:
    """How corrections enter the published pose."""

    duration_s: Annotated[float, Ge(0)] = 0.25
    """A small correction enters over this time in s; 0: every one at once."""
    max_mps: Annotated[float, Gt(0)] = 0.3
    """No faster than this in m/s, on top of the robot's own speed: larger ones take longer,"""
    max_radps: Annotated[float, Gt(0)] = 0.5
    """nor faster than this in rad/s."""
    limit_m: Annotated[float, Ge(0)] = 0.3
    """A larger correction enters at once, as a new epoch."""
    limit_rad: Annotated[float, Ge(0)] = 0.2
    """The same of the heading in rad."""


class Easing:
    """Between the filter's pose and the published one."""

    def __init__(self, params: EasingParams) -> None:
        self._params = params
        self._offset = np.zeros(3)
        self._begun_ns = self._ends_ns = 0
        self.epoch = 0
        """Number of jumps so far."""
        self.delta: Pose2 | None = None
        """x, y and theta of the last jump in the map frame: the new pose less the old one."""

    def corrected(
        self, stamp_ns: int, shown: Pose2, corrected: Pose2, *, is_jump: bool = False
    ) -> None:
        """The filter's pose at ``stamp_ns`` is another now; ``shown`` was published for it."""
        error = corrected.inverse() @ shown
        params = self._params
        far_m, far_rad = error.distance_to(_NOTHING), abs(error.theta_rad)
        if is_jump or (
            params.duration_s > 0.0 and (far_m > params.limit_m or far_rad > params.limit_rad)
        ):
            self.epoch += 1
            self.delta = Pose2(
                corrected.x_m - shown.x_m,
                corrected.y_m - shown.y_m,
                wrap_angle(corrected.theta_rad - shown.theta_rad),
            )
            self._offset, self._ends_ns = np.zeros(3), stamp_ns
            return
        takes_s = 0.0
        if params.duration_s > 0.0:
            takes_s = max(params.duration_s, far_m / params.max_mps, far_rad / params.max_radps)
        self._offset, self._begun_ns = error.log(), stamp_ns
        self._ends_ns = stamp_ns + round(1e9 * takes_s)

    def applied(self, stamp_ns: int, pose: Pose2, covariance: Array) -> tuple[Pose2, Array]:
        """The pose to publish instead of the filter's, and a covariance (3, 3) that covers what
        the two differ by."""
        if stamp_ns >= self._ends_ns:
            return pose, covariance
        left = (self._ends_ns - stamp_ns) / (self._ends_ns - self._begun_ns)
        shown = pose @ Pose2.exp(min(left, 1.0) * self._offset)
        lacking = shown.as_array() - pose.as_array()
        lacking[2] = wrap_angle(float(lacking[2]))
        return shown, covariance + np.outer(lacking, lacking)
