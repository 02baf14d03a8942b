#!/usr/bin/env python3
"""Branch coverage of the whole suite, and of what must not be wrong: ``make coverage``.

Reads the data that ``pytest --cov`` has left and writes a table, with the files that have the most
branches untested. Compiled loops count by what calls them: machine code is not traced.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

REPO: Final = Path(__file__).resolve().parent.parent
PAGE: Final = REPO / "docs/reliability.md"
MARK: Final = "<!-- coverage: written by `make coverage` -->"
_DRIVERS: Final = "drivers/amr_drivers"
GROUPS: Final = {
    "parsers": (
        f"{_DRIVERS}/decoding.py",
        f"{_DRIVERS}/sick_s300/*decoder.py",
        f"{_DRIVERS}/sick_s300/telegrams.py",
        f"{_DRIVERS}/sick_s300/requests.py",
        f"{_DRIVERS}/sick_s300/scan_counter.py",
        *(f"{_DRIVERS}/sick_cola/{name}.py" for name in (
            "decoder", "fields", "framing", "messages", "meaning", "scandata", "sweeps")),
        *(f"{_DRIVERS}/sick_safety/{name}.py" for name in (
            "blocks", "cola2", "datagrams", "decoder", "identity")),
        *(f"{_DRIVERS}/can_odometry/{name}.py" for name in (
            "counting", "dbc", "dbc_decoder", "decoding", "frames", "pairing")),
        f"{_DRIVERS}/can_odometry/cia402/*.py",
    ),
    "filter": ("amr_slam/fusion/*.py",),
    "state machine": (
        "amr_slam/localizer/*.py",
        *(f"amr_slam/{name}.py" for name in (
            "frozen", "hypotheses", "pairing", "seeking", "standing_wheels", "states",
            "suspicions", "trust", "wheel_events")),
    ),
    "everything": ("*",),
}  # fmt: skip
_WORST: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Covered:
    """Of a file, or of many: how much there is, and how much of it ran."""

    lines: int = 0
    lines_run: int = 0
    branches: int = 0
    branches_run: int = 0

    def __add__(self, other: Covered) -> Covered:
        return Covered(
            lines=self.lines + other.lines,
            lines_run=self.lines_run + other.lines_run,
            branches=self.branches + other.branches,
            branches_run=self.branches_run + other.branches_run,
        )


def main() -> int:
    """Print the table; ``--write`` puts it into docs/reliability.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"into {PAGE.relative_to(REPO)}")
    arguments = parser.parse_args()
    text = table(measured())
    print(text)
    if arguments.write:
        before, _, after = PAGE.read_text("utf-8").split(MARK)
        PAGE.write_text(f"{before}{MARK}\n{text}\n{MARK}{after}", "utf-8")
    return 0


def measured() -> dict[str, Covered]:
    """By file, from the data of the last run."""
    with tempfile.TemporaryDirectory() as scratch:
        report = Path(scratch) / "coverage.json"
        # What processes have left that ended after their test: none is no error.
        combine = [sys.executable, "-m", "coverage", "combine", "--append", "--quiet"]
        subprocess.run(combine, check=False, cwd=REPO, stderr=subprocess.DEVNULL)
        command = [sys.executable, "-m", "coverage", "json", "--quiet", "-o", str(report)]
        subprocess.run(command, check=True, cwd=REPO)
        files = json.loads(report.read_text("utf-8"))["files"]
    return {
        name: Covered(
            lines=file["summary"]["num_statements"],
            lines_run=file["summary"]["covered_lines"],
            branches=file["summary"]["num_branches"],
            branches_run=file["summary"]["covered_branches"],
        )
        for name, file in files.items()
    }


def table(files: dict[str, Covered]) -> str:
    """A row a group, then the files of the first three that lack the most branches."""
    rows = ["| what | files | lines | branches |", "|---|--:|--:|--:|"]
    named: set[str] = set()
    for group, patterns in GROUPS.items():
        names = [n for n in files if any(fnmatch.fnmatch(n, pattern) for pattern in patterns)]
        named |= set(names) if group != "everything" else set()
        total = sum((files[name] for name in names), Covered())
        rows.append(
            f"| {group} | {len(names)} | {share(total.lines_run, total.lines)} |"
            f" {share(total.branches_run, total.branches)} |"
        )
    lacking = sorted(named, key=lambda name: files[name].branches_run - files[name].branches)
    worst = [
        f"{name.rpartition('/')[2]} {files[name].branches - files[name].branches_run}"
        for name in lacking[:_WORST]
        if files[name].branches > files[name].branches_run
    ]
    return "\n".join([*rows, "", f"Most branches that no test takes: {', '.join(worst) or '-'}."])


def share(part: int, whole: int) -> str:
    """In per cent."""
    return f"{100.0 * part / max(1, whole):.1f} %"


if __name__ == "__main__":
    sys.exit(main())
