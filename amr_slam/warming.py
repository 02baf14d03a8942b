"""Everything that is compiled, run once before the first scan: compiling takes seconds, loading
what an earlier start compiled takes a moment, and neither may delay a pose."""

from __future__ import annotations

import math

import numpy as np

from amr_slam.clouds import CloudParams, cloud_from_points
from amr_slam.compiled import ENABLED
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.slam_request import SlamRequest

_ROOM_M = (4.0, 3.0)
_BEAMS = 360


def warm_up(params: SlamParams) -> None:
    """Map a small room with exact, noisy and very noisy scans, and localize in it."""
    if not ENABLED:
        return
    rng = np.random.default_rng(0)
    for sigma_m in (0.0, 0.1, 0.3):
        engine = SlamEngine(params, PointMap(params.map), "mapping")
        for step in range(3):
            pose = Pose2(0.3 * step, 0.1 * step, 0.2 * step)
            engine.update(_request(pose, sigma_m, rng, params.clouds))
        finder = SlamEngine(params, engine.map, "localization")
        finder.update(_request(Pose2(0.2, 0.1, 0.1), sigma_m, rng, params.clouds))
        lost = _request(Pose2(0.2, 0.1, 2.0), sigma_m, rng, params.clouds)
        finder.update(SlamRequest(cloud=lost.cloud, map_from_base=None, covariance=None))


def _request(
    pose: Pose2, sigma_m: float, rng: np.random.Generator, params: CloudParams
) -> SlamRequest:
    """What a scanner sees all around it in a rectangular room."""
    step_rad = math.tau / _BEAMS
    angles = step_rad * np.arange(_BEAMS)
    x, y = np.cos(angles + pose.theta_rad), np.sin(angles + pose.theta_rad)
    with np.errstate(divide="ignore"):
        to_x = (np.copysign(_ROOM_M[0], x) - pose.x_m) / x
        to_y = (np.copysign(_ROOM_M[1], y) - pose.y_m) / y
    ranges = np.minimum(to_x, to_y)
    points = ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = points + rng.normal(0.0, sigma_m, points.shape)
    cloud = cloud_from_points(points, Pose2.identity(), params, step_rad=step_rad)
    covariance = np.diag([0.05**2, 0.05**2, 0.03**2])
    return SlamRequest(cloud=cloud, map_from_base=pose, covariance=covariance)


if __name__ == "__main__":  # the installation's last step: no start has to compile any more
    warm_up(SlamParams())
