"""``python -m amr_slam.studies.faults.clocked FILE run ...``: a daemon whose clock can be set.

The seconds in FILE are added to UTC, whenever they are changed, as if somebody had set the
computer's clock; the monotonic clock goes on, as it does then.
"""

from __future__ import annotations

import runpy
import sys
import threading
import time
from pathlib import Path
from typing import Final

_LOOK_S: Final = 0.005


class _Clock:
    """UTC and what is added to it; reading it takes no longer than reading the true one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._true_ns = time.time_ns
        self._added_ns = 0
        self._look()
        threading.Thread(target=self._follow, name="clock", daemon=True).start()

    def time_ns(self) -> int:
        return self._true_ns() + self._added_ns

    def time(self) -> float:
        return 1e-9 * self.time_ns()

    def _look(self) -> None:
        self._added_ns = round(1e9 * float(self._path.read_text("utf-8")))

    def _follow(self) -> None:
        while self._path.exists():
            self._look()
            time.sleep(_LOOK_S)


# The SLAM process imports this module as its __main__ and has no use for the time of day.
if __name__ == "__main__":
    clock = _Clock(Path(sys.argv[1]))
    time.time_ns, time.time = clock.time_ns, clock.time
    del sys.argv[1]
    runpy.run_module("amr_slam", run_name="__main__")
