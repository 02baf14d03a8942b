"""The measures and the path that make sightings and wheels agree best.

Unknown are the base's pose at every sighting and the measures. Each sighting says where a scanner
was, each pair of successive ones what the wheels counted between them; all are weighed by their
noise and solved together (Gauss-Newton on a sparse system). How noisy wheels and sightings are is
unknown as well: it is found by restricted maximum likelihood, the most probable levels once path
and measures are integrated out. So nobody has to guess how much to trust the wheels, and the
uncertainty of the result is the drive's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from amr_slam.calibration.values import Calibration, Measures, Sightings
from amr_slam.calibration.wheels import WheelTrack, between
from amr_slam.geometry import Array, Pose2, wrap_angle

_ROUNDS: Final = 2
"""Noise levels and solution depend on each other; a third round moves nothing by 0.1 sigma."""
_STEPS: Final = 15
_SMALL_STEP: Final = 1e-7
_TRUSTED: Final = 3.0
"""Standard deviations up to which a measurement has its full weight (Huber)."""
# How far the given measures may be off at all (1 sigma): shares of radii and track, then m, m, rad
# and s. Where a drive tells nothing, this is what is left, and it is told as a doubt.
_SHARE, _MOUNTING = 0.2, (0.5, 0.5, 0.5, 0.3)
# Interpolation of counts and poses: no step is known better (m, rad).
_FLOOR: Final = np.array([1e-4, 1e-4, 1e-4])
# Central differences of the wheels' path: smooth over far larger steps than these.
_SHARE_STEP, _TIME_STEP_S = 1e-5, 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class _Noise:
    """Variances: of the wheels' way (m2 per m), of the heading (rad2 per m and per rad of turn),
    and the factor on the sightings' own covariances."""

    along: float = 1e-5
    heading_way: float = 1e-5
    heading_turn: float = 1e-4
    sighting: float = 1.0

    def logs(self) -> Array:
        levels = [self.along, self.heading_way, self.heading_turn, self.sighting]
        return np.asarray(np.log(levels))

    @staticmethod
    def of_logs(logs: Array) -> _Noise:
        a, b, c, d = (float(v) for v in np.exp(np.clip(logs, -25.0, 5.0)))
        return _Noise(along=a, heading_way=b, heading_turn=c, sighting=d)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Linear:
    """The problem about one path and one set of measures, in the sightings' order of time."""

    sighting_error: Array  # (n, 3)
    sighting_by_pose: Array  # (n, 3, 3)
    sighting_by_measure: Array  # (n, 3, 3): of the own scanner's x, y, theta
    wheel_error: Array  # (n - 1, 3)
    wheel_by_before: Array  # (n - 1, 3, 3)
    wheel_by_after: Array  # (n - 1, 3, 3)
    wheel_by_measures: Array  # (n - 1, 3, k)
    travel: tuple[Array, Array]  # (n - 1,) m and rad
    whole: NDArray[np.bool_]  # (n - 1,)


def adjust(
    given: Measures, start: Measures, sightings: Sightings, wheels: WheelTrack
) -> Calibration:
    """The calibration of a drive. ``given``: the measures of the configuration; ``start``: those
    to begin with, as near to the truth as is known."""
    problem = _Problem(given, start, sightings, wheels)
    noise = _Noise()
    for _ in range(_ROUNDS):
        problem.solve(noise)
        noise = problem.likeliest_noise(noise)
    covariance = problem.solve(noise)
    order = problem.order()
    path = problem.path[order]
    times_s = problem.times_s(problem.measures)[order]
    moved = between(path)
    error = wheels.motions(problem.measures, times_s) - moved
    before = wheels.motions(given, times_s) - moved
    for rows in (error, before):
        rows[:, 2] = wrap_angle(rows[:, 2])
        rows[~wheels.whole(times_s)] = np.nan
    return Calibration(
        given=given,
        measures=problem.measures,
        covariance=covariance,
        path=path,
        wheel_error=error,
        before_error=before,
        stamps_ns=sightings.stamps_ns[order],
    )


class _Problem:
    """Path and measures as they are improved."""

    def __init__(
        self, given: Measures, start: Measures, sightings: Sightings, wheels: WheelTrack
    ) -> None:
        self._given = given.as_array()
        self._sightings = sightings
        self._wheels = wheels
        self.measures = start
        mountings = [scanner.base_from_lidar.inverse() for scanner in start.scanners]
        self.path = np.array(
            [
                (Pose2.from_array(pose) @ mountings[scanner]).as_array()
                for pose, scanner in zip(sightings.poses, sightings.scanner, strict=True)
            ]
        )
        self._whitening = np.linalg.inv(np.linalg.cholesky(sightings.covariances))

    def times_s(self, measures: Measures) -> Array:
        """(n,) instants of the sightings by the wheels' clock."""
        lags = np.array([scanner.lag_s for scanner in measures.scanners])
        seconds: Array = self._wheels.seconds(self._sightings.stamps_ns)
        return np.asarray(seconds - lags[self._sightings.scanner])

    def order(self) -> NDArray[np.intp]:
        """Sightings by their instants."""
        return np.argsort(self.times_s(self.measures), kind="stable")

    def solve(self, noise: _Noise) -> Array:
        """Improve until nothing moves; the measures' covariance (k, k)."""
        for _ in range(_STEPS):
            order = self.order()
            linear = self._linear(order)
            system = self._system(linear, noise, order)
            step = system.step()
            self.path[order] += step[: 3 * len(order)].reshape(-1, 3)
            self.path[:, 2] = wrap_angle(self.path[:, 2])
            values = self.measures.as_array() + step[3 * len(order) :]
            self.measures = self.measures.with_values(values)
            if np.abs(step).max() < _SMALL_STEP:
                break
        return system.measures_covariance(len(self._given))

    def likeliest_noise(self, noise: _Noise) -> _Noise:
        """The noise levels of the greatest restricted likelihood at the present solution."""
        order = self.order()
        linear = self._linear(order)

        def cost(logs: Array) -> float:
            return self._system(linear, _Noise.of_logs(logs), order).cost()

        found = minimize(
            cost, noise.logs(), method="Nelder-Mead",
            options={"xatol": 0.05, "fatol": 0.05, "maxfev": 100, "initial_simplex": noise.logs()
                     + np.vstack([np.zeros(4), np.eye(4)])},
        )  # fmt: skip
        return _Noise.of_logs(np.asarray(found.x))

    def _linear(self, order: NDArray[np.intp]) -> _Linear:
        measures, wheels = self.measures, self._wheels
        scanner = self._sightings.scanner[order]
        mounting = np.array([s.base_from_lidar.as_array() for s in measures.scanners])[scanner]
        path = self.path[order]
        c, s = np.cos(path[:, 2]), np.sin(path[:, 2])
        arm_x = c * mounting[:, 0] - s * mounting[:, 1]
        arm_y = s * mounting[:, 0] + c * mounting[:, 1]
        expected = path + np.column_stack([arm_x, arm_y, mounting[:, 2]])
        sighting_error = expected - self._sightings.poses[order]
        sighting_error[:, 2] = wrap_angle(sighting_error[:, 2])
        by_pose = np.tile(np.eye(3), (len(path), 1, 1))
        by_pose[:, 0, 2], by_pose[:, 1, 2] = -arm_y, arm_x
        by_measure = np.tile(np.eye(3), (len(path), 1, 1))
        by_measure[:, 0, 0] = by_measure[:, 1, 1] = c
        by_measure[:, 0, 1], by_measure[:, 1, 0] = -s, s
        moved = between(path)
        by_before = np.zeros((len(path) - 1, 3, 3))
        by_after = np.zeros_like(by_before)
        before_c, before_s = c[:-1], s[:-1]
        by_after[:, 0, 0] = by_after[:, 1, 1] = before_c
        by_after[:, 0, 1], by_after[:, 1, 0] = before_s, -before_s
        by_after[:, 2, 2] = 1.0
        by_before[:, :2, :2] = -by_after[:, :2, :2]
        by_before[:, 0, 2], by_before[:, 1, 2], by_before[:, 2, 2] = moved[:, 1], -moved[:, 0], -1.0
        times_s = self.times_s(measures)[order]
        wheel_error = moved - wheels.motions(measures, times_s)
        wheel_error[:, 2] = wrap_angle(wheel_error[:, 2])
        return _Linear(
            sighting_error=sighting_error,
            sighting_by_pose=by_pose,
            sighting_by_measure=by_measure,
            wheel_error=wheel_error,
            wheel_by_before=by_before,
            wheel_by_after=by_after,
            wheel_by_measures=-self._motion_by_measures(times_s, scanner),
            travel=wheels.travel(measures, times_s),
            whole=wheels.whole(times_s),
        )

    def _motion_by_measures(self, times_s: Array, scanner: NDArray[np.int64]) -> Array:
        """(n - 1, 3, k): how the wheels' motions change with each measure."""
        values = self.measures.as_array()
        result = np.zeros((len(times_s) - 1, 3, len(values)))
        for k in range(3):
            step = np.zeros(len(values))
            step[k] = _SHARE_STEP * values[k]
            high = self._wheels.motions(self.measures.with_values(values + step), times_s)
            low = self._wheels.motions(self.measures.with_values(values - step), times_s)
            result[:, :, k] = (high - low) / (2.0 * step[k])
        for k in range(len(self.measures.scanners)):
            earlier = np.where(scanner == k, _TIME_STEP_S, 0.0)  # a larger lag: an earlier instant
            high = self._wheels.motions(self.measures, times_s - earlier)
            low = self._wheels.motions(self.measures, times_s + earlier)
            result[:, :, 6 + 4 * k] = (high - low) / (2.0 * _TIME_STEP_S)
        return result

    def _system(self, linear: _Linear, noise: _Noise, order: NDArray[np.intp]) -> _System:
        n, k = len(order), len(self._given)
        system = _System(3 * n + k)
        poses = 3 * np.arange(n)
        whitening = self._whitening[order] / np.sqrt(noise.sighting)
        first = 3 * n + 3 + 4 * self._sightings.scanner[order]
        system.add(
            linear.sighting_error,
            whitening,
            [(poses, linear.sighting_by_pose), (first, linear.sighting_by_measure)],
        )
        rows = linear.whole
        measures = np.full(int(rows.sum()), 3 * n)
        system.add(
            linear.wheel_error[rows],
            _wheel_whitening(linear.travel, noise)[rows],
            [
                (poses[:-1][rows], linear.wheel_by_before[rows]),
                (poses[1:][rows], linear.wheel_by_after[rows]),
                (measures, linear.wheel_by_measures[rows]),
            ],
        )
        bounds = np.concatenate(
            [_SHARE * self._given[:3], np.tile(_MOUNTING, len(self.measures.scanners))]
        )
        error = self.measures.as_array() - self._given
        error[5::4] = wrap_angle(error[5::4])
        system.add(
            error[:, None],
            1.0 / bounds[:, None, None],
            [(3 * n + np.arange(k), np.ones((k, 1, 1)))],
        )
        return system


def _wheel_whitening(travel: tuple[Array, Array], noise: _Noise) -> Array:
    """(n - 1, 3, 3) inverse Cholesky factors of the wheels' noise over each interval."""
    way, turned = travel
    heading = noise.heading_way * way + noise.heading_turn * turned
    covariance = np.zeros((len(way), 3, 3))
    covariance[:, 0, 0] = noise.along * way + _FLOOR[0] ** 2
    # Heading noise that acts along the way ends as a shift across it.
    covariance[:, 1, 1] = heading * way**2 / 3.0 + _FLOOR[1] ** 2
    covariance[:, 1, 2] = covariance[:, 2, 1] = 0.5 * heading * way
    covariance[:, 2, 2] = heading + _FLOOR[2] ** 2
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


class _System:
    """Whitened, robustly weighted residuals and their sparse derivatives."""

    def __init__(self, unknowns: int) -> None:
        self._unknowns = unknowns
        self._rows = 0
        self._parts: list[tuple[NDArray[np.intp], NDArray[np.intp], Array]] = []
        self._errors: list[Array] = []
        self._log_determinant = 0.0

    def add(
        self, error: Array, whitening: Array, blocks: list[tuple[NDArray[np.int64], Array]]
    ) -> None:
        """Residuals (m, r), their whitening (m, r, r), and for each block its first unknown (m,)
        and derivative (m, r, c)."""
        m, r = error.shape
        white = np.einsum("nij,nj->ni", whitening, error)
        size = np.sqrt(np.sum(white**2, axis=1))
        weight = np.sqrt(np.minimum(1.0, _TRUSTED / np.maximum(size, 1e-12)))
        self._errors.append((weight[:, None] * white).ravel())
        for first, derivative in blocks:
            values = weight[:, None, None] * np.einsum("nij,njk->nik", whitening, derivative)
            c = values.shape[2]
            rows = self._rows + np.arange(m * r).reshape(m, r, 1)
            columns = first[:, None, None] + np.arange(c)
            self._parts.append(
                (
                    np.broadcast_to(rows, values.shape).ravel(),
                    np.broadcast_to(columns, values.shape).ravel(),
                    values.ravel(),
                )
            )
        self._rows += m * r
        self._log_determinant -= 2.0 * float(
            np.log(np.abs(np.diagonal(whitening, axis1=1, axis2=2))).sum()
        )

    def step(self) -> Array:
        """(unknowns,) what to add to the unknowns."""
        return self._solved()[0]

    def cost(self) -> float:
        """Twice the negative restricted log-likelihood, up to a constant."""
        jacobian, error = self._assembled()
        step, factor = self._solved()
        left = error + jacobian @ step
        curvature = float(np.log(np.abs(factor.U.diagonal())).sum())
        return float(left @ left) + curvature + self._log_determinant

    def measures_covariance(self, k: int) -> Array:
        """(k, k) of the last unknowns."""
        unit = np.zeros((self._unknowns, k))
        unit[-k:] = np.eye(k)
        covariance = np.asarray(self._solved()[1].solve(unit))[-k:]
        return np.asarray(0.5 * (covariance + covariance.T))

    def _assembled(self) -> tuple[Any, Array]:
        rows, columns, values = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        jacobian = coo_matrix((values, (rows, columns)), shape=(self._rows, self._unknowns)).tocsr()
        return jacobian, np.concatenate(self._errors)

    def _solved(self) -> tuple[Array, Any]:
        jacobian, error = self._assembled()
        factor = splu(
            (jacobian.T @ jacobian).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return np.asarray(factor.solve(-(jacobian.T @ error))), factor
