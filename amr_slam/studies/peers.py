"""Other registration methods and ours on the same scans and maps, in the same run.

The peers are optional: those that are not installed get a row that says so.
``pip install --group peers`` brings all of them.
"""

from __future__ import annotations

import math
import os
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from amr_slam.clouds import cloud_from_scan
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams
from amr_slam.pictures import style
from amr_slam.studies.peer_methods import (
    GLOBAL,
    ITERATIONS,
    LOCAL,
    START_M,
    START_RAD,
    Method,
    Query,
    version,
)
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.scenes import Scene, is_right, laboratory_scene, with_noise

SIGMAS_M: Final = (0.0, 0.1, 0.3)
"""Noise in both x and y of each point, in the mapping scans and in those to be found."""
SCANS: Final = 25
"""Scans to find in each world at each noise level."""

_FIRST_SEED = 7500


@dataclass(slots=True, eq=False)
class Tally:
    """One method's results at one noise level."""

    times_s: list[float] = field(default_factory=list)
    """Processor time of all threads."""
    errors_m: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    """Within 0.25 m and 5 degrees."""
    claimed: list[bool] = field(default_factory=list)

    @property
    def false_claims(self) -> int:
        return int(np.sum(np.array(self.claimed) & ~np.array(self.right)))


Results = dict[str, dict[float, Tally]]
"""By the method's name and the noise."""


def run(effort: Effort) -> Section:
    """Find the same scans with every method that is installed, near a start and anywhere."""
    # Read by OpenMP when a peer is loaded; whatever runs beside is counted in the times anyway.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    versions = {method.package: version(method.package) for method in (*LOCAL, *GLOBAL)}
    present = [method for method in (*LOCAL, *GLOBAL) if versions[method.package] is not None]
    results: Results = {m.name: {sigma: Tally() for sigma in SIGMAS_M} for m in present}
    worlds = effort.trials(6)
    for k in range(worlds):
        scene = laboratory_scene(_FIRST_SEED + 100 * effort.seed + k)
        for sigma in SIGMAS_M:
            known, queries = _exercise(scene, sigma)
            for method in present:
                _measure(method, known, queries, results[method.name][sigma])
        effort.progress(f"peers: world {k + 1} of {worlds}")
    return Section(
        title="Peers on the same scans",
        text=_text(worlds),
        tables=(_local_table(results, versions), _global_table(results, versions)),
        pictures=(
            Picture(
                name="peers",
                caption="Left: local alignment at 0.1 m of noise. Right: global localization, "
                "share of scans found right, and crosses for those claimed but wrong.",
                figure=_figure(results),
            ),
        ),
    )


def _exercise(scene: Scene, sigma_m: float) -> tuple[PointMap, list[Query]]:
    """A map at true poses, and scans from covered poses with starts beside them."""
    params = SlamParams()
    model = with_noise(sigma_m)
    rng = np.random.default_rng((scene.world.seed, 3))
    queries = []
    for truth in scene.poses(SCANS, rng):
        scan = scene.scan(model, truth, rng)
        direction = rng.uniform(-math.pi, math.pi)
        turn = START_RAD * rng.choice([-1.0, 1.0])
        start = Pose2(
            truth.x_m + START_M * math.cos(direction),
            truth.y_m + START_M * math.sin(direction),
            truth.theta_rad + turn,
        )
        cloud = cloud_from_scan(scan, model.base_from_lidar, params.clouds)
        queries.append(Query(scan=scan, cloud=cloud, start=start, truth=truth))
    return scene.map_at_truth(model, params), queries


def _measure(method: Method, known: PointMap, queries: Sequence[Query], tally: Tally) -> None:
    find = method.prepare(known)
    find(queries[0])  # what is built on first use belongs to the preparation
    for query in queries[:: method.every]:
        begun_s = time.process_time()
        found = find(query)
        tally.times_s.append(time.process_time() - begun_s)
        tally.errors_m.append(found.pose.distance_to(query.truth))
        tally.right.append(is_right(found.pose, query.truth))
        tally.claimed.append(found.claimed)


_NOISES: Final = tuple(f"{sigma:g}" for sigma in SIGMAS_M)


def _local_table(results: Results, versions: dict[str, str | None]) -> Table:
    columns: tuple[str, ...] = ("method", "version", "median ms", "p99 ms")
    columns += tuple(f"median error mm, noise {noise}" for noise in _NOISES)
    columns += tuple(f"right, {noise}" for noise in _NOISES)
    rows = []
    for method in LOCAL:
        tallies = _tallies(results, method)
        cells = [f"{1e3 * np.median(t.errors_m):.1f}" for t in tallies]
        cells += [_share(t.right) for t in tallies]
        rows.append(_row(method, versions, tallies, cells, len(columns)))
    return Table(
        title="Local alignment, start 0.15 m and 5° off", columns=columns, rows=tuple(rows)
    )


def _global_table(results: Results, versions: dict[str, str | None]) -> Table:
    columns: tuple[str, ...] = ("method", "version", "median ms", "p99 ms")
    columns += tuple(f"right, noise {noise}" for noise in _NOISES)
    columns += tuple(f"wrong claims of all, {noise}" for noise in _NOISES)
    rows = []
    for method in GLOBAL:
        tallies = _tallies(results, method)
        cells = [_share(t.right) for t in tallies]
        cells += [f"{t.false_claims} of {sum(t.claimed)}" for t in tallies]
        rows.append(_row(method, versions, tallies, cells, len(columns)))
    return Table(title="Global localization, no start", columns=columns, rows=tuple(rows))


def _tallies(results: Results, method: Method) -> list[Tally]:
    """One a noise level; none where the method is not installed."""
    return list(results[method.name].values()) if method.name in results else []


def _row(
    method: Method,
    versions: dict[str, str | None],
    tallies: Sequence[Tally],
    cells: Sequence[str],
    width: int,
) -> tuple[str, ...]:
    known = versions[method.package]
    if known is None:
        return (method.name, "not installed", *["-"] * (width - 2))
    times_ms = 1e3 * np.concatenate([tally.times_s for tally in tallies])
    median, p99 = np.quantile(times_ms, (0.5, 0.99))
    return (method.name, known, f"{median:.2f}", f"{p99:.2f}", *cells)


def _share(flags: Sequence[bool]) -> str:
    return f"{sum(flags)} of {len(flags)}"


def _text(worlds: int) -> str:
    settings = "\n".join(f"- {method.name}: {method.setting}." for method in (*LOCAL, *GLOBAL))
    machine = f"{platform.machine()}, {os.cpu_count()} processors, Python"
    return f"""\
{worlds} laboratories; at each noise level (x and y of each point) one map from about 85 scans at
true poses, and {SCANS} new scans from covered poses, the same for every method. All register
against the same points: those of our map, which is thinned where the scans are noisy. Right:
within 0.25 m and 5°; a local method that did not move at all would be at the edge of that, so its
error tells more.

Times are processor time of all threads ({machine} {platform.python_version()}), over all noise
levels. What is made of the map once (search trees, normals, features, signatures) is counted for
nobody, what is made of the scan for everybody. The peers are general methods for clouds in space;
a plane is a hard case for features of three dimensions. Settings, for the peers with one
thread and at most {ITERATIONS} iterations of a local method:

{settings}"""


def _figure(results: Results) -> Figure:
    figure = style.sheet(11.0, 4.2)
    local, anywhere = figure.subplots(1, 2)
    sigma = SIGMAS_M[min(1, len(SIGMAS_M) - 1)]
    for k, method in enumerate(LOCAL):
        drawn_as = style.look(k)
        if method.name in results:
            tally = results[method.name][sigma]
            time_ms, error_mm = 1e3 * np.median(tally.times_s), 1e3 * np.median(tally.errors_m)
            local.semilogx(
                time_ms, error_mm, drawn_as.marker, color=drawn_as.colour, label=method.name
            )
    local.margins(0.1)
    local.set_xticks([0.3, 1, 3, 10, 30, 100, 300], ["0.3", "1", "3", "10", "30", "100", "300"])
    local.minorticks_off()
    local.set_ylim(0.0, None)
    width = 0.8 / len(GLOBAL)
    places = np.arange(len(SIGMAS_M))
    for k, method in enumerate(GLOBAL):
        tallies = _tallies(results, method)
        if tallies:
            x = places + (k - 0.5 * (len(GLOBAL) - 1)) * width
            right = [float(np.mean(tally.right)) for tally in tallies]
            wrong = [tally.false_claims / len(tally.right) for tally in tallies]
            bars = anywhere.bar(x, right, width, color=style.look(k).colour, label=method.name)
            anywhere.plot(x, wrong, "kx", ms=7)
            anywhere.bar_label(bars, fmt="{:.0%}", fontsize=7)
    anywhere.set_xticks(places, _NOISES)
    anywhere.set_ylim(0.0, 1.25)
    style.chart(local, x="median processor time, ms", y="median position error, mm", legend="best")
    style.chart(anywhere, x="noise in x and y, m", y="share of scans", legend="best")
    return figure
