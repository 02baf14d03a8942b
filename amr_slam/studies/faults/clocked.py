"""``python -m amr_slam.studies.faults.clocked FILE run ...``: a daemon whose clock can be set.

The seconds in FILE are added to UTC, whenever they are changed, as if somebody had set the
computer's clock; the monotonic clock goes on, as it does then.
"""

from __future__ import annotations

import runpy
import sys
import time
from collections.abc import Callable
from pathlib import Path


def _set_by(path: Path, true_ns: Callable[[], int]) -> Callable[[], int]:
    return lambda: true_ns() + round(1e9 * float(path.read_text("utf-8")))


# The SLAM process imports this module as its __main__ and has no use for the time of day.
if __name__ == "__main__":
    utc_ns = _set_by(Path(sys.argv[1]), time.time_ns)
    time.time_ns = utc_ns
    time.time = lambda: 1e-9 * utc_ns()
    del sys.argv[1]
    runpy.run_module("amr_slam", run_name="__main__")
