"""Faults on a whole robot, each from its onset until all is well again: docs/reliability.md.

Status 1 if something was said too late, not at all, or wrong.

Example: python tools/faults.py 1 24 32 --quick
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from amr_slam.studies.faults.rows import ROWS
from amr_slam.studies.faults.running import Bench, chosen, run
from amr_slam.studies.faults.settings import QUICK, Pace

REPO = Path(__file__).resolve().parent.parent


def main() -> int:
    """Parse, run, and print the table."""
    arguments = _parser().parse_args()
    rows = chosen(ROWS, arguments.rows)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(
            Path(folder), REPO / "config/wheels.dbc", QUICK if arguments.quick else Pace()
        )
        for f in run(rows, bench):
            print(f, flush=True)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("rows", nargs="*", metavar="ROW", help="numbers of the catalogue; all without")
    add("--quick", action="store_true", help="a scan each 0.5 s and short drives")
    add("--out", type=Path, help="write the page there")
    return parser


if __name__ == "__main__":
    sys.exit(main())
