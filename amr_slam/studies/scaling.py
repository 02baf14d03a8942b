"""Cost and success against the size and the kind of world, and with other scanners."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from amr_slam.map import PointMap
from amr_slam.map.file import encode
from amr_slam.params import preset
from amr_slam.pictures import style
from amr_slam.simulation import SCANNERS, ScannerModel
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.scenes import S300, Scene
from amr_slam.studies.trials import Circumstances, Trial, localize, milliseconds, success, verdicts
from amr_slam.studies.worlds import AREAS_M2, scene_of

_TRIALS: Final = 100
_NOISE_M: Final = 0.01
_TICKS_M2: Final = (200, 500, 1000, 2000, 5000)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Row:
    """One map and the trials in it."""

    kind: str
    area_m2: float
    """Floor that the mapping saw free."""
    mapping_scans: int
    memory_bytes: int
    """All arrays that the map holds once it was asked for everything."""
    file_bytes: int
    first_ms: float
    """The first call after a change of the map: thinning, look-up grids, signatures."""
    trials: list[Trial]

    def cells(self) -> tuple[str, ...]:
        per_1000 = self.memory_bytes * 1e-6 * 1000.0 / max(self.area_m2, 1.0)
        return (
            self.kind,
            f"{self.area_m2:.0f}",
            str(self.mapping_scans),
            success(self.trials),
            *verdicts(self.trials),
            *milliseconds(self.trials),
            f"{self.first_ms:.0f}",
            f"{per_1000:.1f}",
            f"{1e-6 * self.file_bytes:.2f}",
        )


_COLUMNS: Final = (
    "world",
    "seen floor, m2",
    "mapping scans",
    "success",
    "accepted",
    "ambiguous",
    "unknown",
    "wrong accepted",
    "median ms",
    "p99 ms",
    "first call ms",
    "MB per 1000 m2",
    "file MB",
)


def run(effort: Effort) -> Section:
    """Worlds from 50 to 10,000 m2, of several kinds; scanners in one kind."""
    trials = effort.trials(_TRIALS, least=3)
    model = replace(S300, sigma_range_m=_NOISE_M)
    measure(scene_of("hall", effort.seed + 500, 50.0), model, 1)  # loads what is compiled
    rows: list[Row] = []
    largest_m2 = max(200.0, effort.scale * 10_000.0)
    for kind, areas in AREAS_M2.items():
        for area_m2 in (area for area in areas if area <= largest_m2):
            effort.progress(f"scaling: {kind} of {area_m2:g} m2, {trials} trials")
            rows.append(measure(scene_of(kind, effort.seed + 500, area_m2), model, trials))
    scanners: list[Row] = []
    for name, scanner in SCANNERS.items():
        effort.progress(f"scaling: scanner {name}")
        row = measure(scene_of("hall", effort.seed + 500, 500.0, scanner), scanner, trials)
        scanners.append(replace(row, kind=name))
    return Section(
        title="Size and kind of world, scanners",
        text=(
            f"One world a row, mapped at true poses, {trials} scans from covered poses, range "
            f"noise of {_NOISE_M:g} m. Times are processor time of one absolute localization. "
            f"Memory: all arrays of the map, what is derived from it included. In the symmetric "
            f"halls one scan cannot tell the place from its mirror image: *ambiguous* is the right "
            f"verdict there, and half of the best places are the wrong ones."
        ),
        tables=(
            Table(title="Worlds", columns=_COLUMNS, rows=tuple(row.cells() for row in rows)),
            Table(
                title="Scanners, in a hall of 500 m2",
                columns=("scanner", *_COLUMNS[1:]),
                rows=tuple(row.cells() for row in scanners),
            ),
        ),
        pictures=(_figure(rows),),
    )


def measure(scene: Scene, model: ScannerModel, count: int) -> Row:
    """Map, localize, weigh."""
    params = preset("default")
    rng = np.random.default_rng(scene.world.seed)
    known = scene.map_at_truth(model, params)
    under = Circumstances(kind=scene.kind, seed=scene.world.seed, sigma_m=model.sigma_xy_m)
    poses = scene.poses(count, rng, model=model)
    clouds = [scene.cloud(model, pose, rng, params.clouds) for pose in poses]
    begun_s = time.process_time()
    localize(clouds[0], known, params, poses[0], under)
    first_ms = 1e3 * (time.process_time() - begun_s)
    trials = [
        localize(cloud, known, params, pose, under)
        for cloud, pose in zip(clouds, poses, strict=True)
    ]
    return Row(
        kind=scene.kind,
        area_m2=known.area_m2(),
        mapping_scans=len(scene.mapping),
        memory_bytes=held_bytes(known),
        file_bytes=len(encode(known)[0]),
        first_ms=first_ms,
        trials=trials,
    )


def held_bytes(known: PointMap) -> int:
    """Bytes of all numpy arrays that can be reached from a map, each buffer once."""
    return sum(array.nbytes for array in _buffers(known, set()))


def _buffers(thing: Any, met: set[int]) -> Iterable[np.ndarray[Any, Any]]:
    if id(thing) in met:
        return
    met.add(id(thing))
    if isinstance(thing, np.ndarray):
        if isinstance(thing.base, np.ndarray):
            yield from _buffers(thing.base, met)  # a view holds its whole buffer
        else:
            yield thing
    elif isinstance(thing, dict):
        for part in thing.values():
            yield from _buffers(part, met)
    elif isinstance(thing, list | tuple):
        for part in thing:
            yield from _buffers(part, met)
    else:
        names = [name for c in type(thing).__mro__ for name in getattr(c, "__slots__", ())]
        # Search trees tell their arrays under these names, and have no slots.
        for name in (*getattr(thing, "__dict__", {}), *names, "data", "indices"):
            part = getattr(thing, name, None)
            if isinstance(part, np.ndarray | dict | list | tuple) or _is_ours(part):
                yield from _buffers(part, met)


def _is_ours(part: object) -> bool:
    return type(part).__module__.startswith(("amr_slam", "scipy.spatial"))


def _figure(rows: Sequence[Row]) -> Picture:
    figure = style.sheet(11.0, 3.6)
    cost, memory = figure.subplots(1, 2)
    for number, kind in enumerate(dict.fromkeys(row.kind for row in rows)):
        drawn_as = style.look(number)
        marked = f"{drawn_as.marker}{drawn_as.line}"
        some = sorted((r for r in rows if r.kind == kind), key=lambda row: row.area_m2)
        areas = [row.area_m2 for row in some]
        medians = [float(np.median([t.ms for t in row.trials])) for row in some]
        cost.loglog(areas, medians, marked, color=drawn_as.colour, label=kind)
        megabytes = [1e-6 * row.memory_bytes for row in some]
        memory.loglog(areas, megabytes, marked, color=drawn_as.colour, label=kind)
    for axes, says in ((cost, "processor time, ms, median"), (memory, "map in memory, MB")):
        axes.set_xticks(_TICKS_M2, [f"{area:,}" for area in _TICKS_M2])
        axes.minorticks_off()
        style.chart(axes, x="seen floor, m²", y=says, legend="upper left")
    return Picture(
        name="scaling",
        caption="Absolute localization of one scan and memory of the map against its size",
        figure=figure,
    )
