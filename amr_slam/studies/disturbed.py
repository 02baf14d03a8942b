"""Success where the hall differs from its map: blocked beams and moved furniture."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Final

import numpy as np

from amr_slam.params import preset
from amr_slam.pictures import style
from amr_slam.pictures.style import BLUE, VERMILION
from amr_slam.simulation import COVERED, moved_furniture
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.scenes import laboratory_scene, with_noise
from amr_slam.studies.table1 import worlds
from amr_slam.studies.trials import Circumstances, Trial, localize, success, verdicts
from amr_slam.studies.witnesses import disturbed

_SIGMAS_M: Final = (0.0, 0.1)
_BLOCKED: Final = (0.0, 0.1, 0.2, 0.3, 0.4)
_MOVED: Final = (0.1, 0.25, 0.5)


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
    blocked = {u: t for u, t in results.items() if u.moved == 0.0}
    moved = {u: t for u, t in results.items() if u.blocked == 0.0}
    return Section(
        title="Blocked beams and moved furniture",
        text=(
            f"{len(seeds)} laboratories, {len(seeds) * per_world} scans a row from covered poses, "
            f"none of which the maps contain. Blocked: bundles of beams end early, on things that "
            f"no map knows. Moved: of what stands freely in the hall, this share has moved, gone "
            f"or come since the mapping. Success: the best place is within 0.25 m and 5 degrees."
        ),
        tables=(_table("Blocked beams", blocked), _table("Moved furniture", moved)),
        pictures=(_curves(blocked, moved),),
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
    for share in _MOVED:
        changed = replace(scene, world=moved_furniture(scene.world, rng, share))
        under = replace(clean, moved=share)
        free = changed.poses(4 * count, rng, covered=False)
        for pose in itertools.islice((p for p in free if scene.coverage(p) > COVERED), count):
            cloud = disturbed(changed, model, pose, under, rng, params)
            trials.append(localize(cloud, known, params, pose, under))
    return trials


def _table(title: str, results: dict[Circumstances, list[Trial]]) -> Table:
    return Table(
        title=title,
        columns=(
            "sigma",
            "share",
            "trials",
            "success",
            "accepted",
            "ambiguous",
            "unknown",
            "wrong accepted",
        ),
        rows=tuple(
            (f"{u.sigma_m:.1f}", f"{_share(u):.0%}", str(len(t)), success(t), *verdicts(t))
            for u, t in results.items()
        ),
    )


def _share(under: Circumstances) -> float:
    return max(under.blocked, under.moved)


def _curves(
    blocked: dict[Circumstances, list[Trial]], moved: dict[Circumstances, list[Trial]]
) -> Picture:
    figure = style.sheet(10.0, 3.6)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, title, results in (
        (panels[0], "share of beams blocked", blocked),
        (panels[1], "share of furniture moved", moved),
    ):
        for sigma_m, line in zip(_SIGMAS_M, ("-", "--"), strict=True):
            some = {_share(u): t for u, t in results.items() if u.sigma_m == sigma_m}
            shares = sorted(some)
            right = [100.0 * np.mean([t.right for t in some[s]]) for s in shares]
            accepted = [100.0 * np.mean([t.accepted for t in some[s]]) for s in shares]
            noise = f"sigma {sigma_m:g} m"
            axes.plot(shares, right, f"o{line}", color=BLUE, label=f"right, {noise}")
            axes.plot(shares, accepted, f"s{line}", color=VERMILION, label=f"accepted, {noise}")
        axes.set_ylim(0.0, 102.0)
        style.chart(axes, x=title, y="% of scans", legend="lower left")
    return Picture(
        name="disturbed",
        caption="Best place right, and accepted on one scan, against how far the hall differs "
        "from its map",
        figure=figure,
    )
