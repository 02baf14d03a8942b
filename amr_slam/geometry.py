"""Planar rigid transformations and angles. Needs numpy only.

Directions are in the names: ``map_from_base @ base_from_lidar`` is ``map_from_lidar``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Below this turn (rad) the closed forms of exp and log lose digits: a series takes over.
_SMALL_TURN = 1e-4


@overload
def wrap_angle(angle_rad: float) -> float: ...
@overload
def wrap_angle(angle_rad: Array) -> Array: ...
def wrap_angle(angle_rad: float | Array) -> float | Array:
    """The same angle in (-pi, pi]; floats stay floats, arrays keep their shape."""
    if isinstance(angle_rad, np.ndarray):
        wrapped: Array = math.pi - np.mod(math.pi - angle_rad, 2.0 * math.pi)
        # A hair above pi, the modulus rounds up to the whole turn.
        return np.where(wrapped <= -math.pi, math.pi, wrapped)
    if -math.pi < angle_rad <= math.pi:
        return float(angle_rad)
    turned = math.pi - (math.pi - float(angle_rad)) % (2.0 * math.pi)
    return math.pi if turned <= -math.pi else turned


def rotation_matrix(theta_rad: float) -> Array:
    """The 2x2 matrix that turns a column vector counter-clockwise by ``theta_rad``."""
    c, s = math.cos(theta_rad), math.sin(theta_rad)
    return np.array([[c, -s], [s, c]])


@dataclass(frozen=True, slots=True)
class Pose2:
    """A pose or rigid transformation of the plane, SE(2).

    ``theta_rad`` is kept in (-pi, pi]. Tangent vectors are ordered (x, y, theta) and live in the
    frame on the right-hand side (the body): ``pose @ Pose2.exp(v)``.
    """

    x_m: float
    y_m: float
    theta_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "x_m", float(self.x_m))
        object.__setattr__(self, "y_m", float(self.y_m))
        object.__setattr__(self, "theta_rad", wrap_angle(float(self.theta_rad)))

    @staticmethod
    def identity() -> Pose2:
        return Pose2(0.0, 0.0, 0.0)

    @staticmethod
    def from_array(xyt: ArrayLike) -> Pose2:
        """From (x m, y m, theta rad)."""
        x, y, theta = np.asarray(xyt, dtype=np.float64)
        return Pose2(float(x), float(y), float(theta))

    @staticmethod
    def exp(tangent: ArrayLike) -> Pose2:
        """The pose reached from the identity along a constant twist (vx m, vy m, omega rad)."""
        vx, vy, turn = (float(t) for t in np.asarray(tangent, dtype=np.float64))
        if abs(turn) < _SMALL_TURN:
            a, b = 1.0 - turn * turn / 6.0, 0.5 * turn
        else:
            a, b = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
        return Pose2(a * vx - b * vy, b * vx + a * vy, turn)

    def log(self) -> Array:
        """The (3,) constant twist that :meth:`exp` turns into this pose."""
        half = 0.5 * self.theta_rad
        small = abs(self.theta_rad) < _SMALL_TURN
        a = 1.0 - half * half / 3.0 if small else half / math.tan(half)
        return np.array(
            [a * self.x_m + half * self.y_m, -half * self.x_m + a * self.y_m, self.theta_rad]
        )

    def inverse(self) -> Pose2:
        c, s = math.cos(self.theta_rad), math.sin(self.theta_rad)
        return Pose2(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, -self.theta_rad)

    @property
    def rotation(self) -> Array:
        """The 2x2 rotation matrix."""
        return rotation_matrix(self.theta_rad)

    @property
    def translation(self) -> Array:
        """The (2,) translation in m."""
        return np.array([self.x_m, self.y_m])

    def as_array(self) -> Array:
        """(3,): x m, y m, theta rad."""
        return np.array([self.x_m, self.y_m, self.theta_rad])

    def adjoint(self) -> Array:
        """The 3x3 matrix with ``self @ exp(v) == exp(self.adjoint() @ v) @ self``."""
        c, s = math.cos(self.theta_rad), math.sin(self.theta_rad)
        return np.array([[c, -s, self.y_m], [s, c, -self.x_m], [0.0, 0.0, 1.0]])

    @overload
    def __matmul__(self, other: Pose2) -> Pose2: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: Pose2 | Array) -> Pose2 | Array:
        """Compose with a pose, or move an (n, 2) array of points (m)."""
        c, s = math.cos(self.theta_rad), math.sin(self.theta_rad)
        if isinstance(other, Pose2):
            return Pose2(
                self.x_m + c * other.x_m - s * other.y_m,
                self.y_m + s * other.x_m + c * other.y_m,
                self.theta_rad + other.theta_rad,
            )
        moved: Array = other @ np.array([[c, s], [-s, c]]) + np.array([self.x_m, self.y_m])
        return moved

    def is_finite(self) -> bool:
        return math.isfinite(self.x_m) and math.isfinite(self.y_m) and math.isfinite(self.theta_rad)

    def distance_to(self, other: Pose2) -> float:
        """Distance of the two origins in m."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)


def interpolate(start: Pose2, end: Pose2, fraction: float) -> Pose2:
    """The pose ``fraction`` of the way (0..1) from ``start`` to ``end`` at constant twist."""
    return start @ Pose2.exp(fraction * (start.inverse() @ end).log())


def turned(covariance: Array, rotation: Array) -> Array:
    """A covariance (3, 3) of (x, y, theta) in axes from which ``rotation`` (2, 2) leads to others,
    in those others."""
    turn = np.eye(3)
    turn[:2, :2] = rotation
    return np.asarray(turn @ covariance @ turn.T)


def inverse_matrix(matrix: Array) -> Array:
    """The inverse of a square matrix; raises numpy.linalg.LinAlgError where there is none."""
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def readonly(array: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """A contiguous copy that nobody can write to, for frozen values that hold arrays."""
    copy = np.array(array, dtype=dtype, order="C")
    copy.setflags(write=False)
    return copy
