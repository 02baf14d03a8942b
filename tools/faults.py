"""Faults on a whole robot, each from its onset until all is well again: docs/reliability.md.

Status 1 if something was said too late, not at all, or wrong; the lines say what.

Example, rows 1, 24 and 32 in a hurry: python tools/faults.py 1 24 32 --quick
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path

from amr_slam.map import MapError
from amr_slam.studies.faults.page import line, renew, tables
from amr_slam.studies.faults.row import Finding
from amr_slam.studies.faults.rows import ROWS
from amr_slam.studies.faults.running import Bench, chosen, run
from amr_slam.studies.faults.settings import QUICK, Pace

REPO = Path(__file__).resolve().parent.parent


def main() -> int:
    """Parse, run, print what was found, and write the page."""
    arguments = _parser().parse_args()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    pace = QUICK if arguments.quick else Pace()
    begin_s = time.monotonic()
    findings: list[Finding] = []
    try:
        rows = chosen(ROWS, arguments.rows)
        with tempfile.TemporaryDirectory(prefix="faults-") as folder:
            bench = Bench(arguments.keep or Path(folder), REPO / "config/wheels.dbc", pace)
            for finding in run(rows, bench):
                print(line(finding), flush=True)
                findings.append(finding)
    except (MapError, OSError, ValueError) as error:
        print(f"faults: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    order = [row.number for row in rows]
    findings.sort(key=lambda finding: order.index(finding.number))
    written = tables(findings, pace.scan_period_s, time.monotonic() - begin_s)
    print(f"\n{written}")
    if arguments.out is not None:
        renew(arguments.out, written)
    return int(any(finding.broken for finding in findings))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("rows", nargs="*", metavar="ROW", help="numbers as on the page; all without")
    add("--quick", action="store_true", help="a scan each 0.5 s, short drives before and after")
    add("--out", type=Path, help="the page whose tables are renewed")
    add("--keep", type=Path, help="folder for ports, maps and the daemons' logs, kept")
    return parser


if __name__ == "__main__":
    sys.exit(main())
