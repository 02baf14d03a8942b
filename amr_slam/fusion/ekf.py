"""filterpy's extended Kalman filter with the planar body's motion and angles put right.

The only file that imports filterpy. Its ``predict_update`` is not used: it takes the Jacobian
before the prediction and knows no residual.

State (10,): x, y, theta of the base in the map frame; travel, yaw, bend and lag of the wheels
(:class:`amr_slam.fusion.values.Calibration`); x, y, theta of the map's own error where the robot
is. A fix measures pose plus map error: fixes that share their error are no witnesses of each other.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from amr_slam.fusion.covariance import symmetric
from amr_slam.fusion.trail import Composed
from amr_slam.fusion.values import FilterParams
from amr_slam.geometry import Array, Pose2, readonly, wrap_angle

STATES: Final = 10
POSE: Final = slice(0, 3)
CALIBRATION: Final = slice(3, 7)
MAP_ERROR: Final = slice(7, 10)

MEASURED: Final = readonly(np.hstack([np.eye(3), np.zeros((3, 4)), np.eye(3)]))
"""(3, 10): what a fix sees of the state."""


class Ekf(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """filterpy's filter with the motion of a planar body as its input."""

    def __init__(self, params: FilterParams) -> None:
        super().__init__(dim_x=STATES, dim_z=3)
        # filterpy's own x of (n, 1) makes (n, n) of a flat measurement.
        self.x: Array = np.zeros(STATES)
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

    def predict_x(self, u: Composed) -> None:
        """x after a motion; F and Q are the Jacobian there and the noise."""
        end = Pose2.from_array(self.x[POSE]) @ u.delta
        way_m = u.travel_m + u.turn_rad
        kept = math.exp(-way_m / self._range_m)
        c, s = math.cos(end.theta_rad), math.sin(end.theta_rad)
        map_from_body = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        F, Q = np.eye(STATES), np.zeros((STATES, STATES))
        F[0, 2], F[1, 2] = self.x[1] - end.y_m, end.x_m - self.x[0]
        F[POSE, CALIBRATION] = map_from_body @ u.by_calibration
        F[MAP_ERROR, MAP_ERROR] *= kept
        Q[POSE, POSE] = map_from_body @ u.noise @ map_from_body.T
        Q[CALIBRATION, CALIBRATION] = np.diag(self._sigmas**2 * (way_m / self._memory_m))
        Q[MAP_ERROR, MAP_ERROR] = (1.0 - kept**2) * self.map_error
        self.x = np.concatenate([end.as_array(), self.x[CALIBRATION], kept * self.x[MAP_ERROR]])
        self.F, self.Q = F, Q

    def predicted(self, x: Array, P: Array, motion: Composed) -> tuple[Array, Array]:
        """x (10,) and P (10, 10) after a motion; the arguments stay as they are."""
        self.x, self.P = x, P
        self.predict(motion)
        return self.x, self._capped(symmetric(self.P))

    def updated(self, x: Array, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
        """x (10,) and P (10, 10) after a measured pose z (3,) of covariance R (3, 3)."""
        self.x, self.P = x, P
        self.update(z, HJacobian=lambda _: MEASURED, Hx=seen, R=R, residual=residual)
        after = np.array(self.x)
        after[2] = wrap_angle(float(after[2]))
        after[CALIBRATION] = np.clip(after[CALIBRATION], -self._limits, self._limits)
        return after, symmetric(self.P)

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
