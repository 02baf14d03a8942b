"""Localization in a map before and after it went through another program's picture format."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from amr_slam.engine import SlamEngine
from amr_slam.fusion import error95_m
from amr_slam.geometry import Array, Pose2
from amr_slam.map import PointMap, moved
from amr_slam.map.export import write_occupancy
from amr_slam.map.importing import import_map
from amr_slam.params import preset
from amr_slam.slam_request import SlamRequest
from amr_slam.studies.report import Effort, Section, Table
from amr_slam.studies.scenes import S300, Scene, is_right, laboratory_scene, pose_error
from amr_slam.studies.trials import percent
from amr_slam.studies.worlds import scene_of

_NEAR: Final = np.array([0.05, 0.05, math.radians(2.0)])
"""Standard deviations of the expected pose."""
_TURNED: Final = Pose2(3.0, -2.0, math.radians(20.0))
# Seeds of worlds that no other study takes.
_FIRST_WORLD: Final = 7000

Change = Callable[[PointMap, Path], PointMap]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fix:
    """One scan's answer, anywhere or near an expected pose."""

    anywhere: bool
    accepted: bool
    right: bool
    error_m: float
    turn_rad: float
    error95_m: float


def run(effort: Effort) -> Section:
    """Maps made at true poses, as they are, and exported as PGM and YAML and imported again."""
    rows: list[tuple[str, ...]] = []
    per_world = effort.trials(20, least=2)
    for kind, scenes in _scenes(effort).items():
        effort.progress(f"exchanged: {kind}, {len(scenes)} worlds")
        answers: dict[str, list[_Fix]] = {name: [] for name in _FORMS}
        for scene in scenes:
            for name, fixes in _in_world(scene, per_world).items():
                answers[name] += fixes
        rows += [_row(kind, name, fixes) for name, fixes in answers.items()]
    return Section(
        title="Maps exported and imported again",
        text=(
            f"Each map is asked for {per_world} covered poses a world, anywhere without a prior "
            "and near an expected pose (standard deviations 5 cm and 2 degrees); errors are of "
            "the latter. Turned: the map's frame lies at 20 degrees to the walls, which become "
            "stairs of cells. Within: share of the errors below the error95_m that was told."
        ),
        tables=(
            Table(
                title="The same scans in the same map, before and after",
                columns=(
                    "world", "map", "scans", "right anywhere", "accepted anywhere",
                    "wrong accepted", "accepted near", "error median", "p95", "max mm",
                    "turn p95 deg", "error95_m median mm", "within",
                ),
                rows=tuple(rows),
            ),
        ),
    )  # fmt: skip


def _through(cell_m: float) -> Change:
    def change(known: PointMap, folder: Path) -> PointMap:
        _, described = write_occupancy(known, folder / "map.pgm", cell_m)
        return import_map(described, known.name)

    return change


_FORMS: Final[dict[str, tuple[Pose2, Change]]] = {
    "as it is": (Pose2.identity(), lambda known, _: known),
    "cells of 2 cm": (Pose2.identity(), _through(0.02)),
    "cells of 5 cm": (Pose2.identity(), _through(0.05)),
    "cells of 5 cm, turned": (_TURNED, _through(0.05)),
    "cells of 10 cm": (Pose2.identity(), _through(0.1)),
}


def _scenes(effort: Effort) -> dict[str, list[Scene]]:
    seeds = [_FIRST_WORLD + 1000 * effort.seed + i for i in range(effort.trials(6))]
    return {
        "laboratory": [laboratory_scene(seed) for seed in seeds],
        "hall, 1000 m2": [scene_of("hall", seed, 1000.0) for seed in seeds[: effort.trials(3)]],
        "offices, 200 m2": [scene_of("offices", seed, 200.0) for seed in seeds[: effort.trials(3)]],
    }


def _in_world(scene: Scene, count: int) -> dict[str, list[_Fix]]:
    params = preset("default")
    known = scene.map_at_truth(S300, params)
    poses = scene.poses(count, np.random.default_rng(scene.world.seed))
    answers: dict[str, list[_Fix]] = {}
    for name, (new_from_old, change) in _FORMS.items():
        there = known if new_from_old == Pose2.identity() else moved(known, new_from_old)
        with TemporaryDirectory() as folder:
            engine = SlamEngine(params, change(there, Path(folder)), "localization")
        rng = np.random.default_rng((scene.world.seed, 1))
        answers[name] = [
            fix for pose in poses for fix in _asked(engine, scene, pose, new_from_old @ pose, rng)
        ]
    return answers


def _asked(
    engine: SlamEngine, scene: Scene, pose: Pose2, truth: Pose2, rng: np.random.Generator
) -> list[_Fix]:
    """``pose`` in the world, which is ``truth`` in the map's frame."""
    cloud = scene.cloud(S300, pose, rng, engine.params.clouds)
    expected = truth @ Pose2(*rng.normal(0.0, _NEAR))
    requests = (
        SlamRequest(cloud=cloud, map_from_base=None, covariance=None),
        SlamRequest(cloud=cloud, map_from_base=expected, covariance=np.diag(_NEAR**2)),
    )
    return [_answered(engine, request, truth) for request in requests]


def _answered(engine: SlamEngine, request: SlamRequest, truth: Pose2) -> _Fix:
    result = engine.update(request)
    best, fix = result.answer.best, result.fix
    found = fix.map_from_base if fix is not None else best.pose if best is not None else None
    off_m, turn_rad = (math.inf, math.inf) if found is None else pose_error(found, truth)
    return _Fix(
        anywhere=request.map_from_base is None,
        accepted=fix is not None,
        right=found is not None and is_right(found, truth),
        error_m=off_m,
        turn_rad=turn_rad,
        error95_m=0.0 if fix is None else error95_m(fix.covariance),
    )


def _row(kind: str, name: str, fixes: list[_Fix]) -> tuple[str, ...]:
    anywhere = [fix for fix in fixes if fix.anywhere]
    near = [fix for fix in fixes if not fix.anywhere]
    taken = [fix for fix in near if fix.accepted]
    mm = _column([1e3 * fix.error_m for fix in taken])
    return (
        kind,
        name,
        str(len(anywhere)),
        percent(sum(fix.right for fix in anywhere), len(anywhere)),
        percent(sum(fix.accepted for fix in anywhere), len(anywhere)),
        str(sum(fix.accepted and not fix.right for fix in fixes)),
        percent(len(taken), len(near)),
        f"{np.median(mm):.1f}",
        f"{np.percentile(mm, 95.0):.1f}",
        f"{mm.max():.1f}",
        f"{np.percentile(_column([math.degrees(fix.turn_rad) for fix in taken]), 95.0):.2f}",
        f"{np.median(_column([1e3 * fix.error95_m for fix in taken])):.1f}",
        percent(sum(fix.error_m <= fix.error95_m for fix in taken), len(taken)),
    )


def _column(values: list[float]) -> Array:
    return np.array(values or [math.nan])
