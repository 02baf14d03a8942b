"""The weights of :class:`amr_slam.params.Plausibility`, fitted on worlds of many kinds.

The worlds have seeds below :data:`EVALUATED_FROM`: no study judges on them. A negative of a
symmetric hall is left out: its unmapped half *is* the mapped one, and no scan can tell.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from amr_slam.geometry import Array
from amr_slam.params import SlamParams
from amr_slam.studies.real_passes import read_recording
from amr_slam.studies.real_queries import evidence
from amr_slam.studies.report import Effort
from amr_slam.studies.scenes import laboratory_scene
from amr_slam.studies.trials import Trial
from amr_slam.studies.witnesses import evidence_records
from amr_slam.studies.worlds import scene_of

EVALUATED_FROM: Final = 500
"""First seed of the worlds on which the studies judge."""
FEATURES: Final = ("margin", "agreeing", "passes")
_OTHER: Final = 200  # seed of the world that is not the map's, less that of the map's
_CLUTTER: Final = (0.15, 0.25, 0.35)
_RIDGE: Final = 5e-6
_RECORDINGS: Final = ("intel", "mit_csail", "fhw", "seattle", "acapulco")
_MAPPED, _UNMAPPED = (0.85, 1.0), (0.0, 0.3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """A logistic regression: log-odds = bias + sum of weight times feature."""

    bias: float
    weights: tuple[float, ...]

    def plausibility(self, trials: Sequence[Trial]) -> Array:
        """(n,) probability that each trial's best place is the right one."""
        return np.asarray(expit(self.bias + _features(trials) @ np.array(self.weights)))


def trials(effort: Effort) -> Iterator[Trial]:
    """Right places and negatives, clean and cluttered, over laboratories at the paper's noise
    and over halls, offices, corridors and odd worlds at that of scanners."""
    laboratories = itertools.product(range(effort.trials(8)), (0.0, 0.03, 0.1, 0.2, 0.3))
    for seed, sigma_m in laboratories:
        effort.progress(f"laboratory {seed}, sigma {sigma_m} m")
        yield from _in_world("laboratory", seed, 200.0, sigma_m)
    kinds = ("hall", "offices", "corridors", "odd", "symmetric")
    areas = ((1, 200.0), (2, 400.0))
    for kind, (seed, area_m2), sigma_m in itertools.product(
        kinds, areas[: effort.trials(2)], (0.0, 0.02, 0.1)
    ):
        effort.progress(f"{kind} {seed}, sigma {sigma_m} m")
        for trial in _in_world(kind, seed, area_m2, sigma_m):
            if not (kind == "symmetric" and trial.under.negative):
                yield trial


def _in_world(kind: str, seed: int, area_m2: float, sigma_m: float) -> Iterator[Trial]:
    if kind == "laboratory":
        here, other = laboratory_scene(seed), laboratory_scene(seed + _OTHER)
    else:
        here, other = (scene_of(kind, s, area_m2) for s in (seed, seed + _OTHER))
    clutter = _CLUTTER[seed % len(_CLUTTER)]
    for pair in evidence_records(here, other, sigma_m, SlamParams(), 8, clutter=clutter):
        for trial in (pair.first, pair.second):
            if trial.pose is not None:
                yield trial


def recorded(logs: Path, effort: Effort) -> Iterator[Trial]:
    """The same of recordings of real robots: glass, people and clutter that no world has."""
    params = SlamParams()
    for name in _RECORDINGS:
        effort.progress(f"recording {name}")
        passes = read_recording(logs, name, params.clouds)
        for covered, share in ((_MAPPED, 1.0), (_UNMAPPED, 0.5)):
            count = effort.trials(round(120 * share))
            for query in evidence(passes, params, (params.grid_m,), count, 11, covered=covered):
                if query.trial.pose is not None:
                    yield query.trial


def fit(found: Sequence[Trial]) -> Weights:
    """Maximum likelihood, with a touch of ridge so that separable data stay finite."""
    features = np.column_stack([np.ones(len(found)), _features(found)])
    right = np.array([float(trial.right) for trial in found])

    def cost(weights: Array) -> tuple[float, Array]:
        log_odds = features @ weights
        free = np.concatenate([[0.0], weights[1:]])
        likelihood = np.mean(np.logaddexp(0.0, log_odds) - right * log_odds)
        slope = features.T @ (expit(log_odds) - right) / len(right)
        return float(likelihood + 0.5 * _RIDGE * free @ free), slope + _RIDGE * free

    best = minimize(cost, np.zeros(features.shape[1]), jac=True).x
    return Weights(bias=float(best[0]), weights=tuple(float(w) for w in best[1:]))


def describe(found: Sequence[Trial], weights: Weights) -> str:
    """The weights, and what they accept of these trials at a few bars."""
    named = ", ".join(f"{n} {w:.1f}" for n, w in zip(FEATURES, weights.weights, strict=True))
    lines = [f"bias {weights.bias:.1f}, {named} ({len(found)} trials)"]
    probable = weights.plausibility(found)
    right = np.array([trial.right for trial in found])
    negative = np.array([trial.under.negative for trial in found])
    clean = np.array([trial.under.blocked == 0.0 and not trial.under.negative for trial in found])
    for bar in (0.9, 0.95, 0.99):
        accepted = probable >= bar
        lines.append(
            f"accept {bar}: {np.sum(accepted & negative)} of {np.sum(negative)} negatives, "
            f"{np.sum(accepted & ~right & ~negative)} of {np.sum(~right & ~negative)} wrong "
            f"places, recall of right ones without clutter {np.mean(accepted[clean & right]):.1%}"
        )
    return "\n".join(lines)


def _features(found: Sequence[Trial]) -> Array:
    return np.array([[getattr(trial, name) for name in FEATURES] for trial in found])
