"""The paper's table 2 on recordings of real robots: map from some passes, scans of another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from amr_slam.evidence import Verdict
from amr_slam.params import SlamParams
from amr_slam.pictures import style
from amr_slam.pictures.style import BLUE, INK, ORANGE
from amr_slam.studies.real_driving import MOST_SCANS, Claim, first_claim
from amr_slam.studies.real_passes import (
    APART_M,
    APART_S,
    COVERED,
    MAPPED_M,
    PARTS,
    Pass,
    Recording,
    passes,
    read_recording,
    recordings,
)
from amr_slam.studies.real_queries import Query, ask, choose
from amr_slam.studies.report import Effort, Picture, Section, Table
from amr_slam.studies.trials import mean_and_std, percent, success, verdicts

GRIDS_M: Final = (0.2, 0.5, 0.8)
USUAL_M: Final = 0.5
"""The spacing at which most is asked, and all drives are made."""
REQUIRED: Final = {"offices": 95.0, "halls": 90.0, "corridors": 75.0}
"""Per cent of covered scans whose best place is the right one."""

# Scans in each recording: sought at the usual spacing, at the two others, from hardly mapped
# places, and drives. The first of each list are the same.
_QUERIES = 150
_OTHERS = 40
_UNMAPPED = 30
_DRIVES = 30
_HARDLY = 0.3
_NEVER = 10**6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Log:
    """What one recording gave."""

    recording: Recording
    parts: tuple[Pass, ...]
    queries: list[Query]
    unmapped: list[Query]
    drives: list[Claim]

    def at(self, grid_m: float) -> list[Query]:
        return [query for query in self.queries if query.grid_m == grid_m]


def run(effort: Effort, logs: Path) -> Section:
    """Every recording in the folder ``logs`` that has a reference. Raises RecordingError where
    one is damaged, ValueError where there is none."""
    params = SlamParams()
    names = recordings(logs)
    if not names:
        raise ValueError(f"{logs}: no recording with a reference")
    found: list[_Log] = []
    for name in names:
        effort.progress(f"real: {name}")
        found.append(_measure(read_recording(logs, name, params.clouds), params, effort))
    return Section(
        title="Recordings of real robots",
        text=_TEXT.format(
            parts=PARTS, apart_s=APART_S, apart_m=APART_M, covered=COVERED, mapped=MAPPED_M,
            most=MOST_SCANS, hardly=_HARDLY,
        ),
        tables=(_recordings(found), _kinds(found), _logs(found), _drives(found), _beyond(found)),
        pictures=(
            Picture(
                name="real",
                caption="Covered scans at the usual spacing, on all points of each recording at "
                "the reference poses: the best place right (dots), wrong and not accepted "
                "(triangles), wrong and accepted (crosses).",
                figure=_figure(found),
            ),
        ),
    )  # fmt: skip


def _measure(recording: Recording, params: SlamParams, effort: Effort) -> _Log:
    parts = passes(recording.visits)

    def rows(full: int, low: float, high: float) -> list[list[int]]:
        return choose(parts, effort.trials(full, least=2), effort.seed, (low, high))

    usual, others = rows(_QUERIES, COVERED, 1.0), rows(_OTHERS, COVERED, 1.0)
    starts, beyond = rows(_DRIVES, COVERED, 1.0), rows(_UNMAPPED, 0.0, _HARDLY)
    log = _Log(recording=recording, parts=tuple(parts), queries=[], unmapped=[], drives=[])
    for number, one in enumerate(parts):
        if not (usual[number] or beyond[number]):
            continue
        known = one.map(params)
        for grid_m in GRIDS_M:
            wanted = (usual if grid_m == USUAL_M else others)[number]
            log.queries.extend(ask(recording.name, number, one, wanted, known, params, (grid_m,)))
        log.unmapped.extend(
            ask(recording.name, number, one, beyond[number], known, params, (USUAL_M,))
        )
        for row in starts[number]:
            start_ns = one.asked[row].stamp_ns
            log.drives.append(first_claim(recording, known, params, start_ns, one.end_ns))
    return log


_TEXT: Final = """\
Each recording is cut into {parts} parts of equal way. The scans of one part are sought in a map
that is made, at the reference poses, of the scans of the others: only of those at least
{apart_s:g} s and {apart_m:g} m of way before or after the whole part. So no scan is sought in a map
of its own pass, and the map is as right as the reference. Scans are those that have a stamp in the
reference, 0.25 m or 0.25 rad apart; sought are scans drawn at random among the covered ones: at
least {covered:.0%} of their points lie within {mapped:g} m of a point of a mapping scan, both at
the reference poses. No start pose, no wheels, one scan of 180°. Right: within 0.25 m and 5° of the
reference.

The references are published trajectories with errors of 3 to 5 cm and 0.5°. Drawn at these
poses, the walls of all six recordings are single lines, so none is left out; the median error of
the right answers, which contains the reference's own, is in the first table. A recording without a
reference cannot be judged. Kinds go by the look of these maps: offices are rooms with furniture
along corridors; halls are open floors with stands, pillars and partitions; in corridors most scans
see two walls and some doors. acapulco, fhw and seattle hold key scans only, about a metre apart.

*Not findable*: another place fits better even if the reference pose itself is among the
candidates; the other wrong ones were missed by the search. Covered scans may see the other face of
a thin wall than the map's scans did: the criterion asks where points lie, not which way they face.
Driving on: the localizer starts on a covered scan without a start pose and gets the recording's
wheels and its scans at least 2 s apart until it says that it is localized, at most {most}; its
pose at that scan is judged. Drives that end with the part before are cut short. Scans whose place
the map hardly knows (at most {hardly:.0%} of their points on mapped walls) ask for the answer
unknown; an answer there may still be right."""


def _recordings(found: Sequence[_Log]) -> Table:
    rows = []
    for log in found:
        covered = np.concatenate([part.covered for part in log.parts])
        minutes = np.ptp([visit.stamp_ns for visit in log.recording.visits]) / 6e10
        right = [query.trial.error_m for query in log.at(USUAL_M) if query.right]
        rows.append(
            (
                log.recording.name,
                log.recording.kind,
                f"{minutes:.0f}",
                str(len(log.recording.visits)),
                _range([len(part.mapping) for part in log.parts]),
                percent(int(np.sum(covered >= COVERED)), len(covered)),
                f"{1e3 * float(np.median(right)):.0f}" if right else "-",
            )
        )
    return Table(
        title="Recordings",
        columns=(
            "log", "kind", "minutes", "scans", "mapping scans of a part", "covered",
            "median error of right answers mm",
        ),
        rows=tuple(rows),
    )  # fmt: skip


def _kinds(found: Sequence[_Log]) -> Table:
    rows = []
    for kind in dict.fromkeys(log.recording.kind for log in found):
        some = [query for log in found if log.recording.kind == kind for query in log.at(USUAL_M)]
        wrong = [query.trial for query in some if not query.right]
        required = f"{REQUIRED[kind]:g} %" if kind in REQUIRED else "-"
        rows.append(
            (kind, str(len(some)), success([query.trial for query in some]), required,
             str(len(wrong)), *(str(sum(trial.verdict is verdict for trial in wrong))
                                for verdict in Verdict))
        )  # fmt: skip
    return Table(
        title=f"By kind, g = {USUAL_M:g} m",
        columns=(
            "kind",
            "scans",
            "right",
            "required",
            "wrong",
            *(f"of these {v}" for v in Verdict),
        ),
        rows=tuple(rows),
    )


def _logs(found: Sequence[_Log]) -> Table:
    rows = []
    for log in found:
        for grid_m in GRIDS_M:
            some = log.at(grid_m)
            if not some:
                continue
            trials = [query.trial for query in some]
            median_ms, p95_ms = np.quantile([trial.ms for trial in trials], (0.5, 0.95))
            rows.append(
                (
                    log.recording.name,
                    f"{grid_m:g}",
                    str(len(some)),
                    success(trials),
                    percent(sum(query.rank is not None for query in some), len(some)),
                    str(sum(not query.findable for query in some)),
                    *verdicts(trials),
                    *mean_and_std(trial.e_psr_m for trial in trials if trial.right),
                    f"{median_ms:.0f}",
                    f"{p95_ms:.0f}",
                )
            )
    return Table(
        title="Absolute localization from one scan",
        columns=(
            "log", "g m", "scans", "right", "right among places", "not findable", "accepted",
            "ambiguous", "unknown", "accepted but wrong", "e_psr of right mean m", "std m",
            "ms median", "ms p95",
        ),
        rows=tuple(rows),
    )  # fmt: skip


def _drives(found: Sequence[_Log]) -> Table:
    rows = []
    for log in found:
        decided = [one for one in log.drives if not one.cut_short]
        scans = [one.scans if one.located else _NEVER for one in decided]
        rows.append(
            (
                log.recording.name,
                str(len(log.drives)),
                str(len(log.drives) - len(decided)),
                _scans(scans, 0.5),
                _scans(scans, 0.95),
                str(sum(not one.located for one in decided)),
                str(sum(one.wrong for one in decided)),
            )
        )
    return Table(
        title=f"Driving on until the answer is unique, g = {USUAL_M:g} m",
        columns=(
            "log", "drives", "cut short", "scans median", "scans p95",
            f"not located after {MOST_SCANS}", "wrong",
        ),
        rows=tuple(rows),
    )  # fmt: skip


def _scans(needed: Sequence[int], quantile: float) -> str:
    """An observed number of scans, not one between two."""
    if not needed:
        return "-"
    value = int(np.quantile(needed, quantile, method="higher"))
    return str(value) if value < _NEVER else f"> {MOST_SCANS}"


def _beyond(found: Sequence[_Log]) -> Table:
    return Table(
        title=f"Scans of hardly mapped places, g = {USUAL_M:g} m",
        columns=("log", "scans", "right", "accepted", "ambiguous", "unknown",
                 "accepted but wrong"),
        rows=tuple(
            (
                log.recording.name,
                str(len(log.unmapped)),
                success([query.trial for query in log.unmapped]),
                *verdicts([query.trial for query in log.unmapped]),
            )
            for log in found
        ),
    )  # fmt: skip


def _range(values: Sequence[int]) -> str:
    return f"{min(values)} to {max(values)}" if values else "-"


def _figure(found: Sequence[_Log]) -> Figure:
    columns = min(3, len(found))
    height = -(-len(found) // columns)
    figure = style.sheet(4.2 * columns, 3.8 * height)
    panels = figure.subplots(height, columns, squeeze=False).ravel()
    for axes in panels[len(found) :]:
        axes.set_visible(False)
    for axes, log in zip(panels, found, strict=False):
        walls = np.concatenate([v.pose @ v.cloud.points_m[::6] for v in log.recording.visits])
        axes.plot(*walls.T, ",", color=style.GREY, rasterized=True)
        some = log.at(USUAL_M)
        silent = [q for q in some if not q.right and not q.trial.accepted]
        claimed = [q for q in some if q.trial.wrongly_accepted]
        right = [q for q in some if q.right]
        for queries, marker, colour, label in (
            (right, ".", BLUE, "right"),
            (silent, "^", ORANGE, "wrong, not accepted"),
            (claimed, "x", INK, "wrong, accepted"),
        ):
            places = np.array([query.reference.translation for query in queries]).reshape(-1, 2)
            axes.plot(*places.T, marker, color=colour, ms=4, label=label)
        axes.set_aspect("equal")
        title = f"{log.recording.name} ({log.recording.kind})"
        style.chart(axes, x="x in m", y="y in m", title=title)
    panels[0].legend(fontsize=style.LEGEND_PT)
    return figure
