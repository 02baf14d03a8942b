"""Whether what lacks in one study is the filter's fault or chance: the same again, other drives."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.studies.fusion.promise import RUNS, SCENARIOS
from amr_slam.studies.fusion.trials import Trials, joined, trials
from amr_slam.studies.report import Effort, Section, Table

# Of 60 s each. The other two are longer, and what a slip does is no question of chance.
_AGAIN: Final = frozenset({"standing", "driving", "turning", "one scanner", "corridor"})
_STUDIES: Final = 3
_DRAWS_SEED: Final = 0
# How old the newest scan is, in s.
_AGES_S: Final = ((0.0, 1.0), (1.0, 1.5), (1.5, 2.0), (2.0, 3.0))


def study(effort: Effort) -> Section:
    """Each situation in further studies of as many runs, held against perfect filters."""
    shares, ages = [], []
    for scenario in SCENARIOS:
        if scenario.name not in _AGAIN:
            continue
        runs = effort.trials(RUNS, 4)
        seeds = range(effort.seed + 1, effort.seed + 1 + _STUDIES)
        found = [trials(scenario, runs, seed, workers=effort.workers) for seed in seeds]
        together = joined(found)
        shares.append((scenario.name, *_shares(found, together)))
        ages.append((scenario.name, *(_of_age(together, *span) for span in _AGES_S)))
        effort.progress(" | ".join(shares[-1]) + " || " + " | ".join(ages[-1]))
    return Section(
        title="What of it is chance?",
        text=_TEXT.format(studies=_STUDIES, runs=effort.trials(RUNS, 4)),
        tables=(
            Table(
                title="Further studies: steps at which the mean NEES is in its 95 % band",
                columns=(
                    "situation",
                    "each study",
                    "on average",
                    "perfect filters on average",
                    "NEES of all runs (3)",
                    "true error below `error95_m` (95 %)",
                ),
                rows=tuple(shares),
            ),
            Table(
                title="NEES by the age of the newest scan whose fix has come",
                columns=("situation", *(f"{low:g} to {high:g} s" for low, high in _AGES_S)),
                rows=tuple(ages),
            ),
        ),
    )


def _shares(found: list[Trials], together: Trials) -> tuple[str, ...]:
    rng = np.random.default_rng(_DRAWS_SEED)
    perfect = np.mean([one.honest_shares(rng) for one in found], axis=0)
    low, high = np.quantile(perfect, (0.05, 0.95))
    own = [one.consistent for one in found]
    mean, sigma = together.nees_of(np.ones_like(together.is_told))
    return (
        ", ".join(f"{100.0 * share:.0f}" for share in own) + " %",
        f"{100.0 * np.mean(own):.1f} %",
        f"{100.0 * perfect.mean():.1f} % ({100.0 * low:.0f}..{100.0 * high:.0f} %)",
        f"{mean:.2f} ± {2.0 * sigma:.2f}",
        f"{100.0 * together.covered:.1f} ± {200.0 * together.covered_sigma:.1f} %",
    )


def _of_age(one: Trials, low_s: float, high_s: float) -> str:
    mean, sigma = one.nees_of((one.age_s >= low_s) & (one.age_s < high_s))
    return f"{mean:.2f} ± {2.0 * sigma:.2f}"


_TEXT: Final = """{studies} more studies of {runs} runs each, of other drives (the next seeds).
*Perfect filters*: errors that are Gaussian of the claimed covariance and correlated in time as ours
are (see above), the mean over as many studies; in brackets where nine of ten such means lie. The ±
are two standard deviations, by runs."""
