"""Saves a map over and over, as the SLAM process does, and tells the console of each that is safe.

Each save's map has its number as its name. ``saver.py MAP TARGET``
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

from amr_slam.map import load_map, save_map


def main(source: Path, target: Path) -> None:
    """Until the power goes."""
    grown, _ = load_map(source)
    with Path("/dev/console").open("w", encoding="ascii") as console:
        for number in itertools.count(1):
            grown.name = f"save {number}"
            save_map(grown, target, keep=2)
            print(f"saved {number}", file=console, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
