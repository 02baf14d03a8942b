"""How long each command takes to say its first words: ``--help``, and what is wrong in a
configuration.

    OMP_NUM_THREADS=1 python benchmarks/starts.py

Each is started anew, the files being in the page cache. Median, and the longest. Processor time
includes the SLAM process that ``run`` starts in vain.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from amr_slam.cli.arguments import MODULES

_WRONG: Final = '[robot]\nnam = "amr7"\n'


def _once(arguments: list[str]) -> tuple[float, float]:
    """(s until it has ended, s of processor time)."""
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "amr_slam", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return time.perf_counter() - begin, used.ru_utime + used.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=7)
    runs: int = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        wrong = Path(folder) / "wrong.toml"
        wrong.write_text(_WRONG)
        starts = [[command, "--help"] for command in MODULES]
        starts += [[command, "--config", str(wrong)] for command in ("run", "check", "doctor")]
        print(f"{'command':24s} {'wall s':>14s} {'processor s':>14s}")
        for arguments in starts:
            _once(arguments)
            walls, used = zip(*(_once(arguments) for _ in range(runs)), strict=True)
            name = " ".join(arguments).replace(str(wrong), "WRONG")
            pairs = ((statistics.median(times), max(times)) for times in (walls, used))
            figures = "  ".join(f"{median:5.2f} ({longest:5.2f})" for median, longest in pairs)
            print(f"{name:24s} {figures}")


if __name__ == "__main__":
    main()
