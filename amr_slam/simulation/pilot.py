"""Driving a tour by poses that may be late, missing or worth nothing."""

from __future__ import annotations

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import State
from amr_slam.simulation.tour import PathFollower

MAX_POSE_AGE_S = 0.3
"""An older pose is no pose to steer by: at 0.3 m/s the robot is 9 cm further."""
DRIVABLE = frozenset({State.LOCALIZED, State.MAPPING, State.ODOMETRY_ONLY})
"""The states whose poses may be driven by (contracts: ``state``)."""


class CautiousPilot:
    """Follows a closed way by published poses, and stands still while they are not worth it."""

    def __init__(self, path_m: Array) -> None:
        """``path_m``: (n, 2), 5 cm apart, in the frame of the poses to come."""
        self._follower = PathFollower(path_m)

    def command(self, pose: Pose2, state: State, age_s: float) -> tuple[float, float]:
        """(m/s, rad/s) for a pose that was true ``age_s`` ago; one from the future is none."""
        if state not in DRIVABLE or not abs(age_s) <= MAX_POSE_AGE_S:
            return 0.0, 0.0
        return self._follower.steer(pose)
