"""What came out, as a table for people and for the documentation."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from amr_drivers.conformance.bench import Figures

COMMAND: Final = "python -m amr_drivers.conformance"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """One driver in one scenario."""

    rig: str
    scenario: str
    figures: Figures


def line(result: Result) -> str:
    """One line for the terminal."""
    figures = result.figures
    verdict = "passed" if not figures.breaches else "BREACH"
    told = [
        f"{name} {value}"
        for name, value in zip(_COLUMNS, _cells(figures), strict=True)
        if value != _NONE
    ]
    words = [*told, figures.note] if figures.note else told
    lines = [f"{verdict}  {result.rig}: {result.scenario}: {', '.join(words)}"]
    return "\n".join([*lines, *(f"        {breach}" for breach in figures.breaches)])


def page(results: Sequence[Result], effort: str) -> str:
    """docs/drivers/faults.md."""
    rigs = list(dict.fromkeys(result.rig for result in results))
    machine = f"{platform.machine()}, {os.cpu_count()} processors"
    parts = [
        _HEAD.format(
            command=COMMAND,
            effort="" if effort == "quick" else f" --effort {effort}",
            drivers=len(rigs),
            scenarios=len({result.scenario for result in results}),
            machine=machine,
            python=platform.python_version(),
            breaches=sum(bool(result.figures.breaches) for result in results),
        )
    ]
    for rig in rigs:
        own = {r.scenario: r.figures for r in results if r.rig == rig}
        parts.append(f"## {rig}\n{_table(own)}")
    return "\n".join(parts)


_NONE: Final = "-"
_COLUMNS: Final = ("detected in", "back in", "scans lost", "false scans")
_HEAD: Final = """\
# When a scanner fails

Every scanner driver in front of its emulator, in every scenario of the conformance suite:
{drivers} drivers and ways of working, {scenarios} scenarios, {breaches} breaches.
{machine}, Python {python}. Anew: `{command}{effort} --write docs/drivers/faults.md`.
What the scenarios do: [writing-a-driver.md](writing-a-driver.md).

| column | says |
|---|---|
| detected in | from the first sign of the fault (a missing scan: its sweep's end) \
until `status()` names it or `read` raises |
| back in | from the end of the fault to the first true scan; what was lost is opened anew each 0.1 s |
| scans lost | whole sweeps after the end of the fault that were not given, over all repetitions |
| false scans | damaged, mixed, doubled, old, or with a wrong stamp |

Times are the longest of all repetitions; - where a scenario has no such figure.
"""


def _table(own: Mapping[str, Figures]) -> str:
    lines = [f"| fault | {' | '.join(_COLUMNS)} | |", f"|---|{'---|' * len(_COLUMNS)}---|"]
    for scenario, figures in own.items():
        words = "; ".join([figures.note, *figures.breaches]).strip("; ").replace("|", "/")
        lines.append(f"| {scenario} | {' | '.join(_cells(figures))} | {words} |")
    return "\n".join(lines) + "\n"


def _cells(figures: Figures) -> tuple[str, str, str, str]:
    return (
        _NONE if figures.detected_s is None else f"{figures.detected_s:.2f} s",
        _NONE if figures.back_s is None else f"{figures.back_s:.2f} s",
        _NONE if figures.lost is None else str(figures.lost),
        str(figures.false),
    )
