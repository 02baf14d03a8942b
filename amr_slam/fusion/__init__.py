"""Fusion of wheels and SLAM poses: an extended Kalman filter over x, y, theta in the map frame.

Wheels are the filter's input, not a measurement; SLAM poses ("fixes") are corrections at their own
scan's stamp, seconds ago. Kept are the wheels' trail and the fixes of the last seconds. The state
at any instant is the posterior of the last fix before it, predicted once over the composed motion
since: mathematically the stepwise replay, at the cost of one step. A fix that comes late is put in
its place and those after it are gated and absorbed anew, so the state depends on the data alone,
not on the order of their arrival.
"""

from amr_slam.fusion.covariance import error95_m
from amr_slam.fusion.pose_filter import PoseFilter
from amr_slam.fusion.values import FilterEstimate, FilterParams, Innovation

__all__ = ["FilterEstimate", "FilterParams", "Innovation", "PoseFilter", "error95_m"]
