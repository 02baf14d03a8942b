"""Success where the scan differs from the map: blocked beams."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from amr_slam.params import preset
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.scenes import laboratory_scene, with_noise
from amr_slam.studies.table1 import worlds
from amr_slam.studies.trials import Circumstances, Trial, localize, success, verdicts
from amr_slam.studies.witnesses import disturbed

_SIGMAS_M: Final = (0.0, 0.1)
_BLOCKED: Final = (0.0, 0.1, 0.2, 0.3, 0.4)


def run(effort: Effort) -> Section:
    """Covered poses in laboratories mapped at true poses, then disturbed more and more."""
    seeds = worlds(effort)
    per_world = effort.trials(25, least=2)
    results: dict[Circumstances, list[Trial]] = {}
    for sigma_m in _SIGMAS_M:
        effort.progress(f"blocked: sigma {sigma_m:g}, {len(seeds)} worlds")
        for seed in seeds:
            for trial in _in_world(seed, sigma_m, per_world):
                kind = replace(trial.under, seed=0)  # one row over all worlds
                results.setdefault(kind, []).append(trial)
    return Section(
        title="Blocked beams",
        text=(
            f"{len(seeds)} laboratories, {len(seeds) * per_world} scans a row from covered poses, "
            f"none of which the maps contain. Blocked: bundles of beams end early, on things that "
            f"no map knows. Success: the best place is within 0.25 m and 5 degrees."
        ),
        tables=(_table(results),),
        pictures=(_curves(results),),
    )


def _in_world(seed: int, sigma_m: float, count: int) -> list[Trial]:
    scene = laboratory_scene(seed)
    params, model = preset("default"), with_noise(sigma_m)
    known = scene.map_at_truth(model, params)
    rng = np.random.default_rng((seed, round(1e3 * sigma_m)))
    clean = Circumstances(kind=scene.kind, seed=seed, sigma_m=sigma_m)
    trials: list[Trial] = []
    for pose in scene.poses(count, rng):
        for share in _BLOCKED:
            under = replace(clean, blocked=share)
            cloud = disturbed(scene, model, pose, under, rng, params)
            trials.append(localize(cloud, known, params, pose, under))
    return trials


def _table(results: dict[Circumstances, list[Trial]]) -> Table:
    return Table(
        title="Blocked beams",
        columns=(
            "sigma",
            "blocked",
            "trials",
            "success",
            "accepted",
            "ambiguous",
            "unknown",
            "wrong accepted",
        ),
        rows=tuple(
            (f"{u.sigma_m:.1f}", f"{u.blocked:.0%}", str(len(t)), success(t), *verdicts(t))
            for u, t in results.items()
        ),
    )


def _curves(results: dict[Circumstances, list[Trial]]) -> Picture:
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for sigma_m, style in zip(_SIGMAS_M, ("-", "--"), strict=True):
        some = {u.blocked: t for u, t in results.items() if u.sigma_m == sigma_m}
        shares = sorted(some)
        for what, colour, values in (
            ("right", "#0072B2", [np.mean([t.right for t in some[s]]) for s in shares]),
            ("accepted", "#D55E00", [np.mean([t.accepted for t in some[s]]) for s in shares]),
        ):
            label = f"{what}, sigma {sigma_m:g} m"
            axes.plot(
                shares, 100.0 * np.array(values), style, marker="o", color=colour, label=label
            )
    axes.set_xlabel("share of beams blocked")
    axes.set_ylabel("% of scans")
    axes.set_ylim(0.0, 102.0)
    axes.grid(visible=True, color="#DDDDDD")
    axes.legend(fontsize=8)
    return Picture(
        name="blocked",
        caption="Best place right, and accepted on one scan, against the share of blocked beams",
        figure=figure,
    )
