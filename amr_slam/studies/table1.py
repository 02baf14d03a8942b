"""The paper's table 1 in its setting, and SLAM from scratch in the same worlds."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import Preset, SlamParams, preset
from amr_slam.pictures import MapPanel, map_panels
from amr_slam.slam_request import SlamRequest
from amr_slam.studies.drives import Drive, Survey, drive, survey
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.scenes import Scene, laboratory_scene, with_noise
from amr_slam.studies.trials import (
    Circumstances,
    Trial,
    error_mm,
    localize,
    mean_and_std,
    success,
    verdicts,
)

SIGMAS_M: Final = (0.0, 0.1, 0.2, 0.3)
SLAM_SIGMAS_M: Final = (0.0, 0.03, 0.1, 0.2, 0.3)
FIRST_WORLD: Final = 500
"""Seed of the first world: no constant of the algorithm was chosen on worlds from here on."""

# Table 1 as printed: relative mean, std; absolute mean, std, success rate of 10 set-ups.
_PRINTED: Final = {
    0.0: ("0.029", "0.021", "0.018", "0.006", "100 %"),
    0.1: ("0.046", "0.017", "0.036", "0.004", "100 %"),
    0.2: ("0.061", "0.023", "0.066", "0.048", "90 %"),
    0.3: ("0.088", "0.034", "0.079", "0.038", "80 %"),
}
# How far the expected pose is off in the relative case: x and y in m, heading in rad.
_PRIOR_SIGMA = np.array([0.1, 0.1, np.radians(3.0)])
_WORLDS = 20
# Of these worlds, as many for what is slow: maps by SLAM from scratch, and the relative case.
_OWN = 8
_FEWER = 5


def worlds(effort: Effort, full: int = _WORLDS) -> list[int]:
    """Seeds of the worlds that an effort takes, others for another seed of the effort."""
    first = FIRST_WORLD + 1000 * effort.seed
    return list(range(first, first + effort.trials(full)))


@functools.lru_cache(maxsize=256)
def surveyed(seed: int, sigma_m: float) -> tuple[Drive, Survey]:
    """A laboratory driven and mapped from scratch; several studies look at the same drives."""
    driven = drive(laboratory_scene(seed).world, with_noise(sigma_m), seed)
    return driven, survey(driven, preset("default"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _AtSigma:
    """Everything measured at one noise level."""

    sigma_m: float
    paper: list[Trial]
    """The literal paper in maps of its own kind, at true poses; covered poses."""
    at_truth: list[Trial]
    own_map: list[Trial]
    any_pose: list[Trial]
    """Own map, any free pose."""
    relative: dict[Preset, list[float]]
    """Registration errors (eq. 1) in m along the tour in the growing map."""


def run(effort: Effort) -> Section:
    """Relative and absolute, as printed, literally and as this product does it; the four maps."""
    seeds = worlds(effort)
    per_world = effort.trials(100, least=4)
    measured: list[_AtSigma] = []
    for sigma_m in SIGMAS_M:
        effort.progress(f"table1: sigma {sigma_m:g}, {len(seeds)} worlds")
        measured.append(_measure(sigma_m, seeds, per_world, effort.trials(25, least=2)))
    trials = len(seeds) * per_world
    return Section(
        title="Table 1 of the paper, in its setting",
        text=(
            f"{len(seeds)} random laboratories of 200 m2 (seeds {seeds[0]} to {seeds[-1]}), about "
            f"85 scans of 541 beams along a tour; sigma is the noise in x and y of each point, in "
            f"the map's scans and in those to localize. {trials} absolute trials a row "
            f"({len(measured[0].paper)} for the preset `paper`). Success: the best place lies "
            f"within 0.25 m and 5 degrees of the truth. *Covered* poses: more than 85 % of the "
            f"beams end on walls that the mapping saw. The errors are e_psr (eq. 1, eps = 1 m), in "
            f"m, of all trials that gave a pose. Relative: along the tour, map grown at true "
            f"poses, expected pose off by 0.1 m and 3 degrees (1 sigma).\n\n"
            f"`paper` is the letter of the algorithms (one candidate, point-to-point ICP, union of "
            f"scans) in maps made at true poses, which favours it; *own map* is made by SLAM from "
            f"scratch ({min(_OWN, len(seeds))} of the worlds), its frame laid on the world's by "
            f"the whole path. The printed success is of 10 set-ups judged by eye."
        ),
        tables=(_side_by_side(measured), _acceptance(measured)),
        pictures=(figure3(seeds[0]),),
    )


def _measure(sigma_m: float, seeds: Sequence[int], per_world: int, slow: int) -> _AtSigma:
    result = _AtSigma(
        sigma_m=sigma_m,
        paper=[],
        at_truth=[],
        own_map=[],
        any_pose=[],
        relative={"paper": [], "default": []},
    )
    ours, literal = preset("default"), preset("paper")
    model = with_noise(sigma_m)
    for number, seed in enumerate(seeds):
        scene = laboratory_scene(seed)
        under = Circumstances(kind=scene.kind, seed=seed, sigma_m=sigma_m)
        rng = np.random.default_rng((seed, round(1e3 * sigma_m)))
        true_map, paper_map = scene.map_at_truth(model, ours), scene.map_at_truth(model, literal)
        for count, pose in enumerate(scene.poses(per_world, rng)):
            cloud = scene.cloud(model, pose, rng)
            result.at_truth.append(localize(cloud, true_map, ours, pose, under))
            if count < slow:
                result.paper.append(localize(cloud, paper_map, literal, pose, under))
        if number < _OWN:
            driven, own = surveyed(seed, sigma_m)
            map_from_world = own.map_from_start @ driven.world_from_map.inverse()
            for covered, trials in ((True, result.own_map), (False, result.any_pose)):
                for pose in scene.poses(per_world, rng, covered=covered):
                    cloud, here = scene.cloud(model, pose, rng), map_from_world @ pose
                    trials.append(localize(cloud, own.known, ours, here, under))
        if number < _FEWER:
            result.relative["default"] += relative_errors(scene, sigma_m, ours)
            result.relative["paper"] += relative_errors(scene, sigma_m, literal)
    return result


def relative_errors(scene: Scene, sigma_m: float, params: SlamParams) -> list[float]:
    """e_psr in m of each scan of the tour against the map of those before it."""
    rng = np.random.default_rng((scene.world.seed, 1))
    engine = SlamEngine(params, PointMap(params.map), "localization")
    model = with_noise(sigma_m)
    errors: list[float] = []
    for pose in scene.mapping:
        cloud = scene.cloud(model, pose, rng, params.clouds)
        if len(engine.map):
            request = SlamRequest(
                cloud=cloud,
                map_from_base=pose @ Pose2.from_array(rng.normal(0.0, _PRIOR_SIGMA)),
                covariance=np.diag(_PRIOR_SIGMA**2),
            )
            best = engine.update(request).answer.best
            if best is not None:
                errors.append(best.e_psr_m)
        engine.map.insert(cloud, pose)
    return errors


def _side_by_side(measured: Sequence[_AtSigma]) -> Table:
    rows: list[tuple[str, ...]] = []
    for at in measured:
        sigma = f"{at.sigma_m:.1f}"
        rows.append((sigma, "printed", *_PRINTED[at.sigma_m]))
        for who, relative, trials in (
            ("preset `paper`", at.relative["paper"], at.paper),
            ("default, map at true poses", at.relative["default"], at.at_truth),
            ("default, own map", (), at.own_map),
            ("default, own map, any free pose", (), at.any_pose),
        ):
            absolute = mean_and_std(trial.e_psr_m for trial in trials)
            rows.append((sigma, who, *mean_and_std(relative), *absolute, success(trials)))
    return Table(
        title="Registration errors and success",
        columns=("sigma", "who", "relative mean", "std", "absolute mean", "std", "success"),
        rows=tuple(rows),
    )


def _acceptance(measured: Sequence[_AtSigma]) -> Table:
    rows = [
        (f"{at.sigma_m:.1f}", where, *verdicts(trials), error_mm(trials))
        for at in measured
        for where, trials in (
            ("covered, map at true poses", at.at_truth),
            ("covered, own map", at.own_map),
            ("any free pose, own map", at.any_pose),
        )
    ]
    return Table(
        title="What the default preset says of its first scan",
        columns=(
            "sigma",
            "poses",
            "accepted",
            "ambiguous",
            "unknown",
            "wrong accepted",
            "RMSE of right ones, mm",
        ),
        rows=tuple(rows),
    )


def figure3(seed: int) -> Picture:
    """The paper's figure 3 from one laboratory: its map by SLAM from scratch at each noise."""
    panels: list[MapPanel] = []
    for sigma_m in SIGMAS_M:
        _, own = surveyed(seed, sigma_m)
        title = f"sigma = {sigma_m:g} m: ATE {1e3 * own.ate_m:.0f} mm"
        panels.append(MapPanel(title=title, known=own.known, path_m=own.path.poses[:, :2]))
    return Picture(
        name="figure3",
        caption="Maps by SLAM from scratch at the paper's four noise levels (its figure 3): walls "
        "blue, poses of the scans green",
        figure=map_panels(panels, 15.0),
    )
