"""False accepts: what is said of scans from places that the map does not know."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from amr_slam.params import preset
from amr_slam.studies.report import Effort, Section, Table
from amr_slam.studies.scenes import laboratory_scene
from amr_slam.studies.table1 import SIGMAS_M, worlds
from amr_slam.studies.trials import percent
from amr_slam.studies.witnesses import Witnesses, evidence_records

_WORLDS: Final = 20
# Of each of six kinds (right, other world, unmapped half; clean and cluttered), world and sigma.
_PER_KIND: Final = 17
_CLUTTER: Final = 0.25


def run(effort: Effort) -> Section:
    """Single decisions and such with a confirming scan; what they cost in recall."""
    seeds = worlds(effort, _WORLDS)
    records = measure(seeds, effort.trials(_PER_KIND, least=2), effort)
    negatives = [pair for pair in records if pair.first.under.negative]
    right = [pair for pair in records if not pair.first.under.negative]
    alone = sum(pair.first.wrongly_accepted for pair in negatives)
    twice = sum(pair.wrongly_confirmed for pair in negatives)
    return Section(
        title="False accepts, and what they cost in recall",
        text=(
            f"{len(negatives)} negatives, {len(right)} right places, in maps of {len(seeds)} "
            f"laboratories (seeds {seeds[0]} to {seeds[-1]}) at true poses, at sigma "
            f"{', '.join(f'{s:g}' for s in SIGMAS_M)}. Negatives: scans of another laboratory, and "
            f"of the half of the hall that was left out of the map (less than 30 % of the beams "
            f"end on mapped walls); half of each with {_CLUTTER:.0%} of the beams blocked. "
            f"Wrongly accepted means accepted and further than 0.25 m or 5 degrees from the truth. "
            f"The confirming scan is taken 0.6 to 1 m further on, is localized for itself, and "
            f"must be accepted, too, at the same place under the wheels' motion.\n\n"
            f"Over all negatives: {alone} of {len(negatives)} accepted on one scan "
            f"({percent(alone, len(negatives))}), {twice} with the confirming scan "
            f"({percent(twice, len(negatives))})."
        ),
        tables=(_false_accepts(negatives), _recall(right)),
    )


def measure(seeds: Sequence[int], per_kind: int, effort: Effort) -> list[Witnesses]:
    """Pairs of scans in the maps of ``seeds``; each one's other world is the next one's."""
    records: list[Witnesses] = []
    params = preset("default")
    for sigma_m in SIGMAS_M:
        effort.progress(f"negatives: sigma {sigma_m:g}, {len(seeds)} worlds")
        for seed in seeds:
            scene, other = laboratory_scene(seed), laboratory_scene(seed + 1)
            records += evidence_records(scene, other, sigma_m, params, per_kind, clutter=_CLUTTER)
    return records


def _false_accepts(negatives: Sequence[Witnesses]) -> Table:
    rows: list[tuple[str, ...]] = []
    for sigma_m in SIGMAS_M:
        for cluttered in (False, True):
            some = _of(negatives, sigma_m, cluttered=cluttered)
            rows.append(
                (
                    f"{sigma_m:.1f}",
                    "yes" if cluttered else "no",
                    str(len(some)),
                    str(sum(pair.first.wrongly_accepted for pair in some)),
                    str(sum(pair.wrongly_confirmed for pair in some)),
                )
            )
    return Table(
        title="Negatives",
        columns=("sigma", "cluttered", "trials", "accepted on one scan", "and confirmed"),
        rows=tuple(rows),
    )


def _recall(right: Sequence[Witnesses]) -> Table:
    rows: list[tuple[str, ...]] = []
    for sigma_m in SIGMAS_M:
        for cluttered in (False, True):
            some = _of(right, sigma_m, cluttered=cluttered)
            first = [pair.first.accepted and pair.first.right for pair in some]
            second = [pair.second.accepted and pair.second.right for pair in some]
            either = sum(a or b for a, b in zip(first, second, strict=True))
            wrong = sum(pair.first.wrongly_accepted for pair in some)
            rows.append(
                (
                    f"{sigma_m:.1f}",
                    "yes" if cluttered else "no",
                    str(len(some)),
                    percent(sum(first), len(some)),
                    percent(either, len(some)),
                    percent(sum(pair.confirmed for pair in some), len(some)),
                    str(wrong),
                )
            )
    return Table(
        title="Right places, covered: how many are accepted",
        columns=(
            "sigma",
            "cluttered",
            "trials",
            "on the first scan",
            "by the second",
            "confirmed by two",
            "wrong on the first",
        ),
        rows=tuple(rows),
    )


def _of(pairs: Sequence[Witnesses], sigma_m: float, *, cluttered: bool) -> list[Witnesses]:
    return [
        pair
        for pair in pairs
        if pair.first.under.sigma_m == sigma_m and (pair.first.under.blocked > 0.0) == cluttered
    ]
