"""The paper's figures 3 and 4, made of this program's own runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.engine import SlamEngine
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import PoseOdometry
from amr_slam.params import SlamParams
from amr_slam.pictures import MapPanel, map_panels
from amr_slam.recording import RecordingError, read_log
from amr_slam.replay import thin_scans
from amr_slam.samples import Scan
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.table1 import SIGMAS_M, figure3, surveyed, worlds

SCANS: Final = 83
"""Of the paper's dataset A."""
SCAN_PERIOD_S: Final = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Midway:
    """A map while it is being made."""

    known: PointMap
    path_m: Array
    """(n, 2) positions of the scans in the map, last that of ``scan_m``."""
    scan_m: Array
    """(k, 2) points of the scan that was registered last, where it was registered."""


def synthetic(effort: Effort) -> Section:
    """Figure 3: one laboratory mapped from scratch at the paper's four noise levels."""
    seed = worlds(effort)[0]
    rows: list[tuple[str, ...]] = []
    for sigma_m in SIGMAS_M:
        effort.progress(f"figure 3: sigma {sigma_m:g}")
        driven, own = surveyed(seed, sigma_m)
        rows.append(
            (
                f"{sigma_m:g}",
                f"{len(own.results)}",
                f"{sum(result.inserted for result in own.results)}",
                f"{1e3 * own.ate_m:.1f}",
                f"{1e3 * driven.wheels_alone_m():.0f}",
            )
        )
    return Section(
        title="Figure 3: maps of a simulated laboratory at four levels of noise",
        text=_SYNTHETIC.format(seed=seed),
        tables=(
            Table(
                title="The four drives",
                columns=("sigma m", "scans", "in the map", "ATE mm", "wheels alone, ATE mm"),
                rows=tuple(rows),
            ),
        ),
        pictures=(figure3(seed),),
    )


def real(effort: Effort, log: Path) -> Section:
    """Figure 4: the map in the middle of the drive ``log``, and the scan that comes to it.

    Raises RecordingError where the log cannot be read or ends before its map has begun.
    """
    effort.progress(f"figure 4: {log.name}")
    shown = midway(log, effort.trials(SCANS, least=10))
    name = log.name.partition(".")[0]
    panel = MapPanel(
        title=f"{name}: {len(shown.known.path)} scans in the map",
        known=shown.known,
        path_m=shown.path_m,
        scan_m=shown.scan_m,
    )
    return Section(
        title="Figure 4: the map of a real robot, on the way",
        text=_REAL.format(name=name, period=SCAN_PERIOD_S, scans=effort.trials(SCANS, least=10)),
        pictures=(
            Picture(
                name="figure4",
                caption=f"The recording {name} on the way (the paper's figure 4): walls blue, "
                "poses of the scans green, the scan just registered and the robot vermilion",
                figure=map_panels((panel,), 9.0),
            ),
        ),
    )


def midway(log: Path, scans: int) -> Midway:
    """Map a recording with integrated poses from nothing, until ``scans`` have been registered."""
    params = SlamParams()
    recorded = read_log(log)
    names = {sample.scanner for sample in recorded.samples if isinstance(sample, Scan)}
    localizer = Localizer(
        LocalizerParams(),
        FilterParams(),
        params.clouds,
        PoseOdometry(),
        dict.fromkeys(names, Mounting(base_from_lidar=Pose2.identity())),
        "mapping",
    )
    engine = SlamEngine(params, PointMap(params.map, log.name), "mapping")
    registered: list[tuple[Pose2, Array, bool]] = []
    for sample in thin_scans(recorded.samples, SCAN_PERIOD_S):
        localizer.handle(sample)
        request = localizer.take_request()
        if request is None:
            continue
        result = engine.update(request)
        localizer.handle(result)
        if result.answer.best is not None:
            pose = result.answer.best.pose
            registered.append((pose, pose @ request.cloud.points_m, result.inserted))
        if len(registered) == scans:
            break
    if not registered:
        raise RecordingError(f"{log}: no scan could be registered")
    pose, points_m, inserted = registered[-1]
    path = [one for _, one in engine.map.path] + ([] if inserted else [pose])
    return Midway(
        known=engine.map,
        path_m=np.array([one.translation for one in path]),
        scan_m=points_m,
    )


_SYNTHETIC: Final = """\
One random laboratory of 200 m² (seed {seed}), driven once round its tour at 0.3 m/s with one scan
of 541 beams in 2 s, and mapped from scratch: no map, no true pose, wheels that are off by half a
percent. To every point of a scan comes Gaussian noise of sigma in x and in y, as in the paper. What
to look for: where the paper finds its map ever less reliable, the walls here stay lines, because
the map takes the noise out of them again ([why](adr/0008-walls-by-deconvolution.md)); where the
paper's path staggers and has gaps at 0.3 m, this one stays smooth and whole, though a scan or two
may stay out of the map, as the table says. What the noise does cost: small things go first (the
legs of tables, the round posts), corners become round, walls have gaps where they were seen
seldom, and the error along the path grows. Pale streaks beyond the walls are beams whose noise
carried them there: seen floor is drawn as it was measured."""

_REAL: Final = """\
The recording `{name}` of a real robot, thinned to one scan in {period:g} s, mapped from nothing and
stopped when {scans} scans had been registered (while the robot stands, few go into the map). The
paper shows its own laboratory, of which there is no public recording; this one is of an office
building, and as in the paper the map is not finished and most of it was seen from one side only.
The vermilion dots are the new scan at the pose that registration gave it. Where they lie on blue,
the scan says what the map says; where they go on beyond it, the robot sees something new, and there
the map grows next. The pale ground is the floor that beams have passed over."""
