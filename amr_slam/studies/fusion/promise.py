"""Is ``error95_m`` a promise kept, and is the covariance true?"""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amr_slam.evaluation import nees
from amr_slam.pictures import style
from amr_slam.studies.fusion.simulated import CORRIDOR, ONE_SCANNER, Scenario
from amr_slam.studies.fusion.trials import EVERY_S, Trials, trials
from amr_slam.studies.report import Effort, Picture, Section, Table

SCENARIOS: Final = (
    Scenario(name="standing", speed_mps=0.0, turn_radps=0.0),
    Scenario(name="driving"),
    Scenario(name="turning", turn_radps=1.0, on_the_spot=True),
    Scenario(name="one scanner", fix_sigma=tuple(ONE_SCANNER)),
    Scenario(name="no scanner for 60 s", duration_s=110.0, outage_s=(30.0, 90.0)),
    Scenario(name="slip", duration_s=120.0, slips=1.0),
    Scenario(name="corridor", turn_radps=0.02, fix_sigma=tuple(CORRIDOR)),
)
RUNS: Final = 100
# After a slip the wheels count for less during so many fixes.
_DISTRUSTED: Final = 6


def study(effort: Effort) -> Section:
    """Coverage and NEES in each situation, with the reliability diagram."""
    rows, told, found = [], [], {}
    for scenario in SCENARIOS:
        runs = effort.trials(RUNS, 4)
        one = found[scenario.name] = trials(scenario, runs, effort.seed, workers=effort.workers)
        (low, high), honest = one.band, one.honest(np.random.default_rng(effort.seed))
        far = np.hypot(one.errors[..., 0], one.errors[..., 1])
        mean, sigma = one.nees_of(np.ones_like(one.is_told))
        rows.append(
            (
                scenario.name,
                f"{100.0 * one.covered:.1f} ± {196.0 * one.covered_sigma:.1f} %",
                f"{mean:.2f} ± {2.0 * sigma:.2f}",
                f"{100.0 * one.consistent:.0f} % in {low:.2f}..{high:.2f}",
                f"{100.0 * honest[0]:.0f}..{100.0 * honest[1]:.0f} %",
                f"{1e3 * np.sqrt(np.mean(far**2)):.0f}",
                f"{1e3 * np.median(one.error95_m):.0f}",
            )
        )
        effort.progress(" | ".join(rows[-1]))
        if scenario.slips:
            told = _told(one, effort.seed)
            effort.progress(" || ".join(" | ".join(row) for row in told))
    return Section(
        title="Is the claimed error true?",
        text=_TEXT.format(runs=effort.trials(RUNS, 4)),
        tables=(
            Table(
                title="Four estimates a second",
                columns=(
                    "situation",
                    "true error below `error95_m`",
                    "NEES, mean",
                    "steps at which it is in its 95 % band",
                    "an honest filter's share",
                    "rms error mm",
                    "median `error95_m` mm",
                ),
                rows=tuple(rows),
            ),
            Table(
                title="Slip, before and after a scan can tell",
                columns=(
                    "the last slip",
                    "estimates",
                    "true error below `error95_m`",
                    "NEES, mean",
                    "steps at which it is in its 95 % band",
                    "an honest filter's share",
                ),
                rows=tuple(told),
            ),
        ),
        pictures=(
            Picture(
                name="fusion-nees",
                caption="The mean NEES of all runs over time, grey the band of honest ones; "
                "*slip*: of those runs only that a scan has told of their slips",
                figure=_over_time(found),
            ),
            Picture(
                name="fusion-reliability",
                caption="How often the true position error is within what the pose claims for a "
                "given share of cases: the diagonal is honest, above it too cautious",
                figure=_diagram(found),
            ),
        ),
    )


def _told(one: Trials, seed: int) -> list[tuple[str, ...]]:
    """Three rows: the estimates long after the last slip, those of the time in which the wheels are
    distrusted, and those before a scan could tell of it."""
    settled = one.since_slip > _DISTRUSTED
    honest = one.honest(np.random.default_rng(seed), settled)
    shares = (
        f"{100.0 * one.consistent_of(settled):.0f} %",
        f"{100.0 * honest[0]:.0f}..{100.0 * honest[1]:.0f} %",
    )
    return [
        ("none yet, or longer ago", *_part(one, settled), *shares),
        (f"seen, {_DISTRUSTED} fixes ago at most", *_part(one, one.is_told & ~settled), "-", "-"),
        ("not seen by any scan yet", *_part(one, ~one.is_told), "-", "-"),
    ]


def _part(one: Trials, chosen: NDArray[np.bool_]) -> tuple[str, ...]:
    mean, sigma = one.nees_of(chosen)
    return (
        f"{100.0 * np.mean(chosen):.1f} %",
        f"{100.0 * np.mean(one.is_covered[chosen]):.1f} %",
        f"{mean:.2f} ± {2.0 * sigma:.2f}",
    )


def _over_time(found: dict[str, Trials]) -> Figure:
    figure = Figure(figsize=(9.0, 2.0 * len(found)), layout="tight")
    for axes, (name, one) in zip(
        np.atleast_1d(figure.subplots(len(found), 1)), found.items(), strict=True
    ):
        counted = one.is_told.sum(axis=0)
        means = (one.nees * one.is_told).sum(axis=0) / np.maximum(counted, 1)
        axes.axhspan(*one.band, color="0.85")
        axes.plot(EVERY_S * np.arange(len(means)), means, linewidth=1.0)
        axes.set_ylim(0.0, 6.0)
        axes.set_ylabel(name)
    axes.set_xlabel("s")
    return figure


def _diagram(found: dict[str, Trials]) -> Figure:
    figure = style.sheet(7.0, 6.0)
    axes = figure.add_subplot()
    shares = np.linspace(0.02, 0.99, 50)
    axes.plot([0.0, 1.0], [0.0, 1.0], color=style.GREY, linewidth=1.0)
    for number, (name, one) in enumerate(found.items()):
        drawn_as = style.look(number)
        errors = one.errors[..., :2].reshape(-1, 2)
        covariances = one.covariances[..., :2, :2].reshape(-1, 2, 2)
        # Of two degrees of freedom: within the ellipse of share p when d2 <= -2 ln(1 - p).
        d2 = nees(errors, covariances)
        observed = [np.mean(d2 <= -2.0 * np.log(1.0 - p)) for p in shares]
        axes.plot(shares, observed, drawn_as.line, color=drawn_as.colour, label=name)
    style.chart(axes, x="claimed share", y="observed share", legend="upper left")
    return figure


_TEXT: Final = """`error95_m` of the published pose, corrections eased in, against the true error,
over whole runs of 60 to 120 s from the first second on, {runs} a situation. Wheels: each run draws
scales, bend and lag from what `fusion.calibration` believes before it has learned anything (5 % of
the travel, 10 % of turns, 0.03 rad/m, 0.05 s, within its limits), and noise of 1 % of the root of
the way. Fixes: every 2 s, 0.2 to 0.8 s old on arrival, with white errors of the claimed covariance
(4 mm, 1.5 mrad; one scanner: 8 mm along; corridor: 0.5 m along) plus an error of the map (5 mm,
1.5 mrad) that fades over 5 m and stays while the robot stands. *No scanner*: no fix from 30 s to
90 s. *Slip*: once a minute one wheel spins by 5 to 30 cm within up to a second.

The ± are two standard deviations, by runs. A standing robot's error hardly changes: its 100 runs
are 100 cases, of which 5 ± 4 are to be missed. The situations of 60 s share their random numbers,
run by run: they are no witnesses of each other.

NEES is that of the filter's own pose, of three degrees of freedom, its error taken as the twist
from the pose to the truth ([why](adr/0020-errors-as-twists.md)). If the covariance is true, the
mean over the runs lies in the band at 95 % of the steps, on average over many such studies; in one
of them it may be more or less, as neighbouring steps say the same. *An honest filter's share*: what
errors that are Gaussian of the claimed covariance, and correlated in time as these are, reach in
nine of ten studies.

*Slip* is far from it, and must be: between a slip and the next scan, 2 or 3 of 100 runs at any
moment, the filter does not know of it, and one such run brings the mean of a hundred out of the
band. A covariance that contained slips always would be too large by a factor of five for every
robot that does not slip; `error95_m`, which promises 95 %, holds. The second table parts these
estimates. *Not seen yet*: from the slip's beginning until a fix has come whose scan is later than
its end; nothing that the robot has tells of it, unless the wheel leapt. *Seen, 6 fixes ago at
most*: wheels that have slipped may slip again, and count for less with each fix until they are
believed again; the pose is then better than it claims, on purpose."""
