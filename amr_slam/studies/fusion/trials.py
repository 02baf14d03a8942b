"""Many drives of one situation: how far the fused pose is off, and what it claims."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2
from amr_slam.studies.fusion.product import estimates, localizer, off, twist_off
from amr_slam.studies.fusion.simulated import Scenario, WheelErrors, record, start_covariance

EVERY_S: Final = 0.25
"""Between two estimates of a run."""
# How often an honest filter's runs are drawn to see how much their share varies.
_DRAWS: Final = 400
_CHUNK: Final = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trials:
    """Many runs of one scenario."""

    errors: Array
    """(runs, steps, 3) published pose less the truth."""
    covariances: Array
    """(runs, steps, 3, 3) published."""
    whitened: Array
    """(runs, steps, 3) error of the filter's own pose, into which corrections enter at once, as a
    twist in units of what the covariance claims: white and of variance 1 where that is true."""
    error95_m: Array
    """(runs, steps)"""
    since_slip: NDArray[np.int64]
    """(runs, steps) fixes of scans after the last slip that have come; 0: of a slip before that
    nobody can know."""
    age_s: Array
    """(runs, steps) since the newest scan whose fix has come, or since the given pose."""

    @property
    def is_told(self) -> NDArray[np.bool_]:
        """(runs, steps) whether all that the wheels have missed so far is in a scan that has
        come."""
        return self.since_slip > 0

    @property
    def nees(self) -> Array:
        """(runs, steps) normalized squared error of the filter's own pose."""
        return np.asarray(np.square(self.whitened).sum(axis=-1))

    def nees_of(self, chosen: NDArray[np.bool_]) -> tuple[float, float]:
        """Mean of :attr:`nees` over the chosen (runs, steps), and its standard deviation, by
        runs."""
        counts = chosen.sum(axis=1)
        sums = (self.nees * chosen).sum(axis=1)
        mean = float(sums.sum() / counts.sum())
        off = sums - mean * counts
        runs = len(counts)
        return mean, float(off.std(ddof=1) * np.sqrt(runs) / counts.sum())

    @property
    def is_covered(self) -> Array:
        """(runs, steps) whether the true error was below the claimed one."""
        far = np.hypot(self.errors[..., 0], self.errors[..., 1])
        return np.asarray(far <= self.error95_m)

    @property
    def covered(self) -> float:
        """Share of all steps at which the true error was below the claimed one."""
        return float(np.mean(self.is_covered))

    @property
    def covered_sigma(self) -> float:
        """Standard deviation of :attr:`covered`: the steps of one run are no witnesses of each
        other, the runs are."""
        by_run = self.is_covered.mean(axis=1)
        return float(by_run.std(ddof=1) / np.sqrt(len(by_run)))

    @property
    def band(self) -> tuple[float, float]:
        """Between these lie 95 % of the means of NEES over so many runs, if the covariance is
        true."""
        low, high = _bands(np.array([len(self.whitened)]))
        return float(low[0]), float(high[0])

    @property
    def consistent(self) -> float:
        """Share of the steps at which the mean NEES over the runs lies in its band."""
        return self.consistent_of(np.ones_like(self.is_told))

    def consistent_of(self, chosen: NDArray[np.bool_]) -> float:
        """The same over those runs alone that are chosen (runs, steps) at that step."""
        return _inside(self.whitened, chosen)

    def honest(
        self, rng: np.random.Generator, chosen: NDArray[np.bool_] | None = None
    ) -> tuple[float, float]:
        """Between these lie 90 % of the shares that filters of true covariance reach with so many
        runs. ``chosen``: as in :meth:`consistent_of`."""
        low, high = np.quantile(self.honest_shares(rng, chosen), (0.05, 0.95))
        return float(low), float(high)

    def honest_shares(
        self, rng: np.random.Generator, chosen: NDArray[np.bool_] | None = None
    ) -> Array:
        """(n,) shares that filters of true covariance reach with so many runs, their errors
        correlated in time as these are.

        Drawn: Gaussian mixtures of the runs at hand, made white at every step.
        """
        runs = len(self.whitened)
        whitened = self.whitened if chosen is None else self.whitened * chosen[..., None]
        spread = np.einsum("rti,rtj->tij", whitened, whitened) / runs
        to_white = np.linalg.inv(np.linalg.cholesky(spread))
        white = np.einsum("tij,rtj->rti", to_white, whitened) / np.sqrt(runs)
        every = np.ones_like(self.is_told)
        draws = (rng.standard_normal((runs, runs)) for _ in range(_DRAWS))
        return np.array([_inside(np.tensordot(draw, white, axes=1), every) for draw in draws])


def _inside(whitened: Array, counted: NDArray[np.bool_]) -> float:
    """Share of the steps at which the mean over the runs that count there lies in its band."""
    runs = counted.sum(axis=0)
    low, high = _bands(runs)
    by_step = (np.square(whitened).sum(axis=-1) * counted).sum(axis=0) / runs
    return float(np.mean((by_step >= low) & (by_step <= high)))


def _bands(runs: NDArray[np.int64]) -> tuple[Array, Array]:
    """(n,) and (n,) see :attr:`Trials.band`, for each number of runs."""
    return chi2.ppf(0.025, 3 * runs) / runs, chi2.ppf(0.975, 3 * runs) / runs


def trials(
    scenario: Scenario,
    runs: int,
    seed: int,
    params: FilterParams | None = None,
    *,
    workers: int = 1,
) -> Trials:
    """``runs`` drives with wheels as wrong as the filter believes that they may be."""
    one = partial(_run, scenario, params or FilterParams(), seed)
    if workers == 1:
        found = [one(run) for run in range(runs)]
    else:
        # Spawned: a fork would copy the locks of the threads that numpy has started.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context) as pool:
            found = list(pool.map(one, range(runs), chunksize=_CHUNK))
    return joined(found)


def joined(parts: Sequence[Trials]) -> Trials:
    """All their runs, which are of one scenario."""
    return Trials(
        errors=np.concatenate([one.errors for one in parts]),
        covariances=np.concatenate([one.covariances for one in parts]),
        whitened=np.concatenate([one.whitened for one in parts]),
        error95_m=np.concatenate([one.error95_m for one in parts]),
        since_slip=np.concatenate([one.since_slip for one in parts]),
        age_s=np.concatenate([one.age_s for one in parts]),
    )


def _run(scenario: Scenario, params: FilterParams, seed: int, run: int) -> Trials:
    """One drive."""
    rng = np.random.default_rng((seed, run))
    wrong = believed(params, rng)
    drive = record(scenario, wrong, rng)
    spread = start_covariance()
    start = drive.truth[0].as_array() + rng.normal(0.0, 1.0, 3) * np.sqrt(np.diag(spread))
    robot = localizer(params, Pose2.from_array(start), spread)
    every = round(EVERY_S / (1e-9 * drive.wheels[1].stamp_ns))
    rows = []
    for one, truth in estimates(drive, robot, every):
        assert robot.filter is not None
        own, covariance = robot.filter.map_from_base, robot.filter.covariance
        white = np.linalg.solve(np.linalg.cholesky(covariance), twist_off(own, truth))
        since_slip = drive.fixes_since_slip(one.stamp_ns)
        age_s = 1e-9 * (one.stamp_ns - drive.newest_scan_ns(one.stamp_ns))
        error = off(one.map_from_base, truth)
        rows.append((error, one.covariance, white, one.error95_m, since_slip, age_s))
    errors, covariances, whitened, claims, since, ages = (
        np.array(column)[None] for column in zip(*rows, strict=True)
    )
    return Trials(
        errors=errors,
        covariances=covariances,
        whitened=whitened,
        error95_m=claims,
        since_slip=since,
        age_s=ages,
    )


def believed(params: FilterParams, rng: np.random.Generator) -> WheelErrors:
    """Wheels as wrong as the filter believes at first, within the limits of what it can learn."""
    limits, sigmas = params.calibration.limits, params.calibration.sigmas
    drawn = sigmas * rng.standard_normal(4)
    while (np.abs(drawn) > limits).any():
        drawn = sigmas * rng.standard_normal(4)
    return WheelErrors(travel=drawn[0], yaw=drawn[1], bend_radpm=drawn[2], lag_s=drawn[3])
