"""Processor and memory of the daemon's processes, out of /proc."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20


class Usage:
    """What some processes use together, since the last look."""

    def __init__(self) -> None:
        self._looked_s = time.monotonic()
        self._used_s: dict[int, float] = {os.getpid(): time.process_time()}

    def look(self, pids: Iterable[int]) -> tuple[float, float]:
        """(per cent of one processor since the last look, resident memory in MB).

        Processes that are gone count nothing, those that are new from their start.
        """
        now_s, used_s, memory_mb = time.monotonic(), 0.0, 0.0
        before, self._used_s = self._used_s, {}
        for pid in pids:
            try:
                stat = Path(f"/proc/{pid}/stat").read_text()
            except OSError:
                continue
            # proc(5): the name in brackets may hold anything; utime, stime, rss are 14, 15, 24.
            fields = stat.rpartition(")")[2].split()
            self._used_s[pid] = (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
            used_s += self._used_s[pid] - before.get(pid, 0.0)
            memory_mb += int(fields[21]) * _PAGE_MB
        elapsed_s = max(now_s - self._looked_s, 1e-3)
        self._looked_s = now_s
        return max(0.0, 100.0 * used_s / elapsed_s), memory_mb
