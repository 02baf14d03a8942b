"""Fusion of wheels and SLAM poses: an extended Kalman filter over x, y, theta in the map frame.

Wheels are the filter's input, not a measurement; SLAM poses ("fixes") are corrections at their own
scan's stamp, seconds ago. Kept are the wheels' trail and the fixes of the last seconds. The state
at any instant is the posterior of the last fix before it, predicted once over the composed motion
since: mathematically the stepwise replay, at the cost of one step. A fix that comes late is put in
its place and those after it are gated and absorbed anew, so the state depends on the data alone,
not on the order of their arrival.

Beside the pose the filter learns what the wheels are wrong by (scales, lag), carries the map's own
error, and tells slipping wheels from wrong fixes; :class:`Easing` lets corrections into the
published pose. Why so: ``docs/adr/0014-wheels-learned-while-driving.md``.
"""

from amr_slam.fusion.covariance import error95_m
from amr_slam.fusion.easing import Easing, EasingParams
from amr_slam.fusion.pose_filter import PoseFilter
from amr_slam.fusion.values import (
    Calibration,
    CalibrationParams,
    FilterEstimate,
    FilterParams,
    Innovation,
    Slip,
)

__all__ = [
    "Calibration",
    "CalibrationParams",
    "Easing",
    "EasingParams",
    "FilterEstimate",
    "FilterParams",
    "Innovation",
    "PoseFilter",
    "Slip",
    "error95_m",
]
