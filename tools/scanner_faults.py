"""Scanner faults on simulated robots: the tables of docs/scanner-faults.md.

Example, a quick look: python tools/scanner_faults.py --worlds hall --seeds 21 --periods 8
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator

from amr_slam.studies.report import Table
from amr_slam.studies.scanner_faults import (
    FAULTS,
    WORLDS,
    Found,
    clean,
    false_alarms,
    find,
    scene,
)

BEGINS = {"on the way": (False, False), "at the start": (True, False), "new map": (True, True)}
DISTURBED = ("people", "furniture", "blocked", "everything")


def main() -> int:
    """Print both tables as Markdown."""
    arguments = _parser().parse_args()
    places = list(itertools.product(arguments.worlds, arguments.seeds))
    rows: dict[tuple[str, str], list[Found]] = {}
    for kind, seed in places:
        known = scene(kind, seed)
        for fault, begins in itertools.product(FAULTS, arguments.begins):
            at_start, mapping = BEGINS[begins]
            found = find(
                fault, known, at_start=at_start, mapping=mapping, seed=seed,
                periods=arguments.periods,
            )  # fmt: skip
            rows.setdefault((fault.name, begins), []).append(found)
            _say(f"{kind} {seed}, {fault.name} {begins}: {found}")
    columns = ("fault", "begins", "found after scans", "named right", "worst error m", "back after",
               "scans in the new map")  # fmt: skip
    cells = tuple((*key, *_cells(found)) for key, found in rows.items())
    if cells:
        _print(Table(title="Faults", columns=columns, rows=cells))
    for disturbed in arguments.clean:
        counts = list(_clean(places, disturbed, arguments.periods))
        scans, alone, told = (sum(column) for column in zip(*counts, strict=True))
        sys.stdout.write(f"{disturbed}: {scans} scans, {alone} suspected alone, {told} told\n")
        sys.stdout.flush()
    return 0


def _cells(found: list[Found]) -> tuple[str, ...]:
    after = [str(one.after or "never") for one in found]
    named = sum(one.right for one in found)
    back = [str(one.back_after or "-") for one in found]
    scans = [str(one.scans) for one in found]
    worst_m = max(one.worst_m for one in found)
    return (", ".join(after), f"{named} of {len(found)}", f"{worst_m:.2f}", ", ".join(back),
            ", ".join(scans))  # fmt: skip


def _clean(
    places: list[tuple[str, int]], disturbed: str, periods: int
) -> Iterator[tuple[int, int, int]]:
    for (kind, seed), located, scanners in itertools.product(places, (True, False), (1, 2)):
        run = clean(kind, seed, disturbed, located=located, scanners=scanners)
        yield false_alarms(run, periods)


def _print(table: Table) -> None:
    sys.stdout.write(table.markdown() + "\n\n")
    sys.stdout.flush()


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--worlds", nargs="+", choices=list(WORLDS), default=list(WORLDS))
    add("--seeds", nargs="+", type=int, default=[21, 22])
    add("--periods", type=int, default=12, help="scan periods of 2 s with the fault, and after it")
    add("--begins", nargs="*", choices=list(BEGINS), default=list(BEGINS))
    add("--clean", nargs="*", choices=DISTURBED, default=list(DISTURBED))
    return parser


if __name__ == "__main__":
    sys.exit(main())
