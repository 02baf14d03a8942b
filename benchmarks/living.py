"""A day with moving furniture and people: does localization last, and does the diff tell the truth?

Usage: python benchmarks/living.py [--hours 24] [--seed 3] [--pictures docs/images]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from amr_slam.studies import living


def main(argv: list[str]) -> int:
    """Prints the table, and writes the pictures where they are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--hours", type=int, default=24)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--pictures", metavar="FOLDER", type=Path)
    arguments = parser.parse_args(argv)
    begun_s = time.process_time()
    done = living.day(arguments.seed, arguments.hours, lambda text: print(text, file=sys.stderr))
    print(living.table(done))
    print(f"the policy has taken in {done.renewed.taken} changes")
    people = living.strangers(done.renewed.known, done.worlds)
    print(f"wall points of the renewed map that no wall of the day explains: {people:.2%}")
    print(f"{time.process_time() - begun_s:.0f} s of CPU")
    if arguments.pictures is not None:
        living.draw(done, arguments.pictures)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
