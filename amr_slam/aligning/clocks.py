"""Two trajectories of one robot, from two systems with clocks of their own, as pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.aligning.fit import Fit, FitParams, fit_pairs
from amr_slam.aligning.pairs import AlignError, PosePairs, Track
from amr_slam.evaluation import poses_at
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.recording import Trajectory

_MOST_PAIRS: Final = 20_000
_STEP_NS: Final = 100_000_000
"""Grid on which the two motions are laid over each other."""
_BASE: Final = 5
"""Motion is what changes in twice so many steps: a second."""
_NEAR_S: Final = 5.0
"""Clocks whose times overlap are taken to differ by less."""
_LEAST_OVERLAP_S: Final = 20.0
_LEAST_LIKENESS: Final = 0.5
_STANDS_OUT: Final = 0.05
_APART_S: Final = 2.0
_WAY_MOST_M: Final = 2.0
"""More in a second is a marker that was taken for another one."""
_HALF_RATE_NS: Final = 100_000_000
_SETTLED_S: Final = 0.002
_ROUNDS: Final = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimedFit:
    """A fit of two trajectories."""

    pairs: PosePairs
    fit: Fit
    clock_s: float
    """This added to a stamp of the camera's is the map's."""


def fit_tracks(
    camera: Track,
    known: Trajectory,
    params: FitParams,
    marker: Pose2 | None = None,
    clock_s: float | None = None,
) -> TimedFit:
    """Pair by time and fit, again with the clock difference that the fit finds.

    ``clock_s``: where it is known. Raises AlignError: see :func:`pair_by_time` and
    :func:`amr_slam.aligning.fit.fit_pairs`.
    """
    fixed = clock_s is not None
    now_s = clock_s if clock_s is not None else clock_difference_s(camera, known)
    for _ in range(_ROUNDS):
        pairs = pair_by_time(camera, known, now_s)
        if fixed:
            pairs = replace(pairs, twists=None)
        fit = fit_pairs(pairs, params, marker)
        if abs(fit.clock_s) < _SETTLED_S:
            break
        now_s += fit.clock_s
    return TimedFit(pairs=pairs, fit=fit, clock_s=now_s + fit.clock_s)


def pair_by_time(camera: Track, known: Trajectory, clock_s: float) -> PosePairs:
    """The map's pose at each instant of the camera's, ``clock_s`` added to its stamps.

    Raises AlignError where fewer than two instants are in both.
    """
    every = max(1, -(-len(camera.stamps_ns) // _MOST_PAIRS))
    stamps, poses = camera.stamps_ns[::every], camera.poses[::every]
    at_ns = stamps + round(1e9 * clock_s)
    here, valid = poses_at(known, at_ns)
    if int(valid.sum()) < 2:
        raise AlignError(
            "the two trajectories share no time: are they of the same drive? "
            "--clock S names what to add to the camera's stamps"
        )
    at_ns, here = at_ns[valid], here[valid]
    return PosePairs(
        labels=tuple(f"{1e-9 * stamp_ns:.3f} s" for stamp_ns in stamps[valid].tolist()),
        site=poses[valid],
        map=here,
        twists=_twists(known, at_ns, here),
    )


def _twists(known: Trajectory, at_ns: NDArray[np.int64], here: Array) -> Array:
    """(n, 3) speeds in the base frame, from where it was shortly before and after."""
    first, last = int(known.stamps_ns[0]), int(known.stamps_ns[-1])
    early_ns = np.clip(at_ns - _HALF_RATE_NS, first, last)
    late_ns = np.clip(at_ns + _HALF_RATE_NS, first, last)
    early, known_early = poses_at(known, early_ns)
    late, known_late = poses_at(known, late_ns)
    step = late - early
    turn = wrap_angle(step[:, 2])
    c, s = np.cos(here[:, 2]), np.sin(here[:, 2])
    ahead, left = c * step[:, 0] + s * step[:, 1], c * step[:, 1] - s * step[:, 0]
    duration_s = 1e-9 * np.maximum(late_ns - early_ns, 1)
    rates = np.stack([ahead, left, turn], axis=1) / duration_s[:, None]
    told = known_early & known_late & (late_ns > early_ns)
    return np.where(told[:, None], rates, 0.0)


def clock_difference_s(camera: Track, known: Trajectory) -> float:
    """What to add to the camera's stamps, to a tenth of a second: where both moved alike.

    Where the times overlap, near 0; else wherever one fits, if only one does. Raises AlignError
    where several do, or none.
    """
    if len(camera.stamps_ns) < 2 or len(known) < 2:
        raise AlignError("a trajectory of less than two poses")
    ours, theirs = known.stamps_ns, camera.stamps_ns
    shared_ns = min(ours[-1], theirs[-1]) - max(ours[0], theirs[0])
    shorter_ns = min(ours[-1] - ours[0], theirs[-1] - theirs[0])
    overlapping = bool(shared_ns > 0.5 * shorter_ns)
    lags, likeness = _likeness(_signal(theirs, camera.poses), _signal(ours, known.poses))
    lag_s = 1e-9 * (lags * _STEP_NS + (ours[0] - theirs[0]))
    if overlapping:
        near = np.abs(lag_s) <= _NEAR_S
        if not near.any() or likeness[near].max() < _LEAST_LIKENESS:
            return 0.0  # a robot that hardly moves tells no more
        return float(lag_s[near][int(np.argmax(likeness[near]))])
    if not len(lag_s) or likeness.max() < _LEAST_LIKENESS:
        raise AlignError(
            "the stamps of both trajectories do not overlap, and at no clock difference did both "
            "move alike; --clock S names what to add to the camera's stamps"
        )
    best = int(np.argmax(likeness))
    others = likeness[np.abs(lag_s - lag_s[best]) > _APART_S]
    if len(others) and others.max() > likeness[best] - _STANDS_OUT:
        raise AlignError(
            "the stamps of both trajectories do not overlap, and several clock differences fit "
            "(rounds that repeat?); --clock S names what to add to the camera's stamps"
        )
    return float(lag_s[best])


def _signal(stamps_ns: NDArray[np.int64], poses: Array) -> Array:
    """(2, n) way in m and turn in rad within a second, every 0.1 s; NaN where nothing is known."""
    grid = np.arange(stamps_ns[0], stamps_ns[-1] + 1, _STEP_NS)
    rows = np.clip(np.searchsorted(stamps_ns, grid), 1, len(stamps_ns) - 1)
    rows -= (grid - stamps_ns[rows - 1]) < (stamps_ns[rows] - grid)
    sampled = poses[rows].copy()
    sampled[np.abs(grid - stamps_ns[rows]) > 2 * _STEP_NS] = np.nan
    signal = np.full((2, len(grid)), np.nan)
    if len(grid) > 2 * _BASE:
        step = sampled[2 * _BASE :] - sampled[: -2 * _BASE]
        way = np.hypot(step[:, 0], step[:, 1])
        step[~(way <= _WAY_MOST_M)] = np.nan
        signal[0, _BASE:-_BASE] = np.where(np.isfinite(step[:, 0]), way, np.nan)
        told = np.isfinite(step[:, 2])
        signal[1, _BASE:-_BASE] = np.where(
            told, wrap_angle(np.where(told, step[:, 2], 0.0)), np.nan
        )
    return signal


def _likeness(theirs: Array, ours: Array) -> tuple[NDArray[np.int64], Array]:
    """Lags (k,) in steps of their signal against ours, and the correlation (k,) at each; only
    where they overlap long enough."""
    size = 1 << int(theirs.shape[1] + ours.shape[1]).bit_length()
    lags = np.arange(-theirs.shape[1] + 1, ours.shape[1])
    total, weight = np.zeros(len(lags)), np.zeros(len(lags))
    most_s = 0.1 * min(theirs.shape[1], ours.shape[1])
    least = max(min(_LEAST_OVERLAP_S, 0.9 * most_s), 0.3 * most_s) / 0.1
    for mine, other in zip(ours, theirs, strict=True):
        correlation, count = _correlated(mine, other, lags, size)
        told = np.isfinite(correlation) & (count >= least)
        total += np.where(told, correlation, 0.0)
        weight += told
    known = weight > 0
    return lags[known], total[known] / weight[known]


def _correlated(
    ours: Array, theirs: Array, lags: NDArray[np.int64], size: int
) -> tuple[Array, Array]:
    """Pearson's correlation (k,) of what overlaps at each lag, and how much that is."""

    def crossed(a: Array, b: Array) -> Array:
        found = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        return np.asarray(found[lags % size])

    here, there = np.isfinite(ours).astype(float), np.isfinite(theirs).astype(float)
    a, b = np.where(here > 0, ours, 0.0), np.where(there > 0, theirs, 0.0)
    count = np.round(crossed(here, there))
    safe = np.maximum(count, 1.0)
    mean_a, mean_b = crossed(a, there) / safe, crossed(here, b) / safe
    var_a = crossed(a * a, there) / safe - mean_a**2
    var_b = crossed(here, b * b) / safe - mean_b**2
    both = crossed(a, b) / safe - mean_a * mean_b
    moving = (var_a > 1e-5) & (var_b > 1e-5)
    return np.where(moving, both / np.sqrt(np.where(moving, var_a * var_b, 1.0)), np.nan), count
