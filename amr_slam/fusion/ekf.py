"""The extended Kalman filter: motion of a planar body, update in Joseph's form, angles wrapped.

Why it is not filterpy's, which the tests compare it with: docs/adr/0036-an-own-kalman-filter.md.

State (10,): x, y, theta of the base in the map frame; travel, yaw, bend and lag of the wheels
(:class:`amr_slam.fusion.values.Calibration`); x, y, theta of the map's own error where the robot
is. A fix measures pose plus map error: fixes that share their error are no witnesses of each other.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from amr_slam.fusion.composing import Composed
from amr_slam.fusion.covariance import symmetric
from amr_slam.fusion.values import FilterParams
from amr_slam.geometry import Array, Pose2, readonly, wrap_angle

STATES: Final = 10
POSE: Final = slice(0, 3)
CALIBRATION: Final = slice(3, 7)
MAP_ERROR: Final = slice(7, 10)

MEASURED: Final = readonly(np.hstack([np.eye(3), np.zeros((3, 4)), np.eye(3)]))
"""(3, 10): what a fix sees of the state."""


class Ekf:
    """Functions of a state that is given: nothing is remembered but the parameters."""

    def __init__(self, params: FilterParams) -> None:
        self._sigmas = params.calibration.sigmas
        self._limits = params.calibration.limits
        self._memory_m = params.calibration.memory_m
        self._range_m = params.map_error_range_m
        self.map_error = readonly(
            np.diag([params.map_error_m**2, params.map_error_m**2, params.map_error_rad**2])
        )

    def start(
        self, pose: Pose2, covariance: Array, known: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """x and P at the beginning, the pose with its (3, 3) covariance.

        ``known``: (4,) and (4, 4) of the wheels' calibration; then the pose was found in the map
        and shares its error. None: nothing was learned yet, and the pose is given.
        """
        x, P = np.zeros(STATES), np.zeros((STATES, STATES))
        x[POSE] = pose.as_array()
        P[POSE, POSE] = covariance
        P[CALIBRATION, CALIBRATION] = np.diag(self._sigmas**2)
        P[MAP_ERROR, MAP_ERROR] = self.map_error
        if known is not None:
            x[CALIBRATION], P[CALIBRATION, CALIBRATION] = known
            P[POSE, POSE] += self.map_error
            P[POSE, MAP_ERROR] = P[MAP_ERROR, POSE] = -self.map_error
        return x, P

    def predicted(self, x: Array, P: Array, motion: Composed) -> tuple[Array, Array]:
        """x (10,) and P (10, 10) after a motion; the arguments stay as they are."""
        end = Pose2.from_array(x[POSE]) @ motion.delta
        way_m = motion.travel_m + motion.turn_rad
        kept = math.exp(-way_m / self._range_m)
        c, s = math.cos(end.theta_rad), math.sin(end.theta_rad)
        map_from_body = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        F, Q = np.eye(STATES), np.zeros((STATES, STATES))
        F[0, 2], F[1, 2] = x[1] - end.y_m, end.x_m - x[0]
        F[POSE, CALIBRATION] = map_from_body @ motion.by_calibration
        F[MAP_ERROR, MAP_ERROR] *= kept
        Q[POSE, POSE] = map_from_body @ motion.noise @ map_from_body.T
        Q[CALIBRATION, CALIBRATION] = np.diag(self._sigmas**2 * (way_m / self._memory_m))
        Q[MAP_ERROR, MAP_ERROR] = (1.0 - kept**2) * self.map_error
        after = np.concatenate([end.as_array(), x[CALIBRATION], kept * x[MAP_ERROR]])
        return after, self._capped(symmetric(F @ P @ F.T + Q))

    def updated(self, x: Array, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
        """x (10,) and P (10, 10) after a measured pose z (3,) of covariance R (3, 3).

        Raises LinAlgError where the innovation's covariance cannot be inverted.
        """
        S = MEASURED @ P @ MEASURED.T + R
        K = np.linalg.solve(S, MEASURED @ P).T
        after = x + K @ residual(z, seen(x))
        after[2] = wrap_angle(float(after[2]))
        after[CALIBRATION] = np.clip(after[CALIBRATION], -self._limits, self._limits)
        kept = np.eye(STATES) - K @ MEASURED
        return after, symmetric(kept @ P @ kept.T + K @ R @ K.T)

    def _capped(self, P: Array) -> Array:
        """Nothing learned is less certain than what was believed before."""
        shrink = np.ones(STATES)
        deviations = np.sqrt(np.diag(P)[CALIBRATION])
        above = deviations > self._sigmas
        if above.any():
            shrink[CALIBRATION][above] = self._sigmas[above] / deviations[above]
            P = shrink[:, None] * P * shrink
        return P


def seen(x: Array) -> Array:
    """(3,) what a fix should read in state x (10,)."""
    return np.asarray(x[POSE] + x[MAP_ERROR])


def residual(z: Array, x: Array) -> Array:
    """z - x (3,) with the angle wrapped."""
    return np.array([z[0] - x[0], z[1] - x[1], wrap_angle(float(z[2] - x[2]))])
