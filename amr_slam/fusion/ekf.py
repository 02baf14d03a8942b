"""filterpy's extended Kalman filter with the planar body's motion and angles put right.

The only file that imports filterpy. Its ``predict_update`` is not used: it takes the Jacobian
before the prediction and knows no residual.
"""

from __future__ import annotations

import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from amr_slam.fusion.covariance import symmetric
from amr_slam.geometry import Array, Pose2, readonly, wrap_angle
from amr_slam.samples import Motion

_IDENTITY = readonly(np.eye(3))


class Ekf(ExtendedKalmanFilter):  # type: ignore[misc]  # filterpy has no types
    """filterpy's filter with the motion of a planar body as its input."""

    def __init__(self) -> None:
        super().__init__(dim_x=3, dim_z=3)
        self.x: Array = np.zeros(3)  # filterpy's own (3, 1) makes (3, 3) of a flat measurement
        self.P: Array = np.eye(3)

    def predict_x(self, u: Motion) -> None:
        """x = x composed with u.delta; F and Q are the Jacobian there and u's noise in the map."""
        x, y, theta = (float(value) for value in self.x)
        end = Pose2(x, y, theta) @ u.delta
        self.x = end.as_array()
        self.F = np.array([[1.0, 0.0, y - end.y_m], [0.0, 1.0, end.x_m - x], [0.0, 0.0, 1.0]])
        c, s = math.cos(end.theta_rad), math.sin(end.theta_rad)
        map_from_body = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.Q = map_from_body @ u.covariance @ map_from_body.T

    def predicted(self, x: Array, P: Array, motion: Motion) -> tuple[Array, Array]:
        """x (3,) and P (3, 3) after a motion; the arguments stay as they are."""
        self.x, self.P = x, P
        self.predict(motion)
        return self.x, symmetric(self.P)

    def updated(self, x: Array, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
        """x (3,) and P (3, 3) after a measured pose z (3,) of covariance R (3, 3)."""
        self.x, self.P = x, P
        self.update(z, HJacobian=lambda _: _IDENTITY, Hx=lambda x: x, R=R, residual=residual)
        return np.append(self.x[:2], wrap_angle(float(self.x[2]))), symmetric(self.P)


def residual(z: Array, x: Array) -> Array:
    """z - x (3,) with the angle wrapped."""
    return np.array([z[0] - x[0], z[1] - x[1], wrap_angle(float(z[2] - x[2]))])
