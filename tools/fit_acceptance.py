"""Fit the weights of acceptance anew: what to write into amr_slam/params.py, class Plausibility.

Example: python tools/fit_acceptance.py --scale 0.2 --logs recordings/
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from amr_slam.studies import acceptance
from amr_slam.studies.report import Effort


def main() -> int:
    """Measure, fit one half, show the other half, and fit all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the worlds")
    parser.add_argument("--logs", type=Path, help="folder of the recordings that take part")
    arguments = parser.parse_args()
    effort = Effort(scale=arguments.scale, progress=lambda line: print(line, file=sys.stderr))
    found = list(acceptance.trials(effort))
    if arguments.logs is not None:
        found += acceptance.recorded(arguments.logs, effort)
    halves = [[t for t in found if t.under.seed % 2 == parity] for parity in (0, 1)]
    if all(halves):
        print("fitted on even seeds, shown on odd ones:")
        print(acceptance.describe(halves[1], acceptance.fit(halves[0])))
    print("fitted on all:")
    print(acceptance.describe(found, acceptance.fit(found)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
