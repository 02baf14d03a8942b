"""Wheel odometry: two successive samples of one source become one :class:`Motion`.

The noise law is a variance proportional to travel, the only one that does not depend on how often
the wheels are read. It enters along the step, not at its end, so that a step cut into pieces keeps
its covariance, and a standing wheel adds exactly nothing.
"""

from amr_slam.odometry.differential import DifferentialDrive
from amr_slam.odometry.kinds import drive_kinds
from amr_slam.odometry.poses import PoseOdometry
from amr_slam.odometry.protocol import (
    Odometry,
    along_the_step,
    elapsed_s,
    gap,
    is_possible,
    joints_of,
)
from amr_slam.odometry.tricycle import TricycleDrive

__all__ = [
    "DifferentialDrive",
    "Odometry",
    "PoseOdometry",
    "TricycleDrive",
    "along_the_step",
    "drive_kinds",
    "elapsed_s",
    "gap",
    "is_possible",
    "joints_of",
]
