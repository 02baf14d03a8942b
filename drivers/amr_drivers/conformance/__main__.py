"""``python -m amr_drivers.conformance [RIG ...]``: the suite as a command."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from amr_drivers.conformance.report import Result, line, page
from amr_drivers.conformance.scenarios import SCENARIOS
from amr_drivers.conformance.table import all_rigs, rigs_named


def main() -> int:
    """Run the scenarios one after another; 1 on a breach, 2 on a name that is not known."""
    parser = _parser()
    arguments = parser.parse_args()
    try:
        rigs = rigs_named(arguments.rigs) if arguments.rigs else all_rigs()
    except ValueError as error:
        parser.error(str(error))
    if arguments.write is not None and not arguments.write.parent.is_dir():
        parser.error(f"{arguments.write}: there is no folder {arguments.write.parent}")
    results: list[Result] = []
    for rig, make in rigs.items():
        for scenario in arguments.only or SCENARIOS:
            with tempfile.TemporaryDirectory() as folder:
                figures = SCENARIOS[scenario](make, Path(folder), arguments.effort)
            results.append(Result(rig=rig, scenario=scenario, figures=figures))
            sys.stdout.write(line(results[-1]) + "\n")
            sys.stdout.flush()
    if arguments.write is not None:
        arguments.write.write_text(page(results, arguments.effort), encoding="utf-8")
    return int(any(result.figures.breaches for result in results))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m amr_drivers.conformance",
        description="Let scanners fail, and see what their drivers say.",
        epilog="Example: python -m amr_drivers.conformance sick_s300 --only standby frozen",
    )
    parser.add_argument(
        "rigs",
        nargs="*",
        metavar="RIG",
        help="the beginning of a rig's name, or module:function of a function that gives rigs; "
        "default: all that are known",
    )
    parser.add_argument("--only", nargs="+", choices=list(SCENARIOS), help="some scenarios")
    parser.add_argument(
        "--effort",
        choices=("quick", "full"),
        default="full",
        help="quick: as in the tests; full: every byte of a telegram is cut at",
    )
    parser.add_argument("--write", type=Path, metavar="PAGE", help="write the table as Markdown")
    return parser


if __name__ == "__main__":
    sys.exit(main())
