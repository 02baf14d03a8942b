"""What a driver leaves behind in its process: threads and file descriptors."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

_GRACE_S: Final = 2.0
"""What an emulator's last thread may take to notice that its connection is gone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Belongings:
    """Open files and living threads of this process."""

    files: Counter[str]
    threads: frozenset[threading.Thread]

    @classmethod
    def now(cls) -> Self:
        return cls(files=_files(), threads=frozenset(threading.enumerate()))

    def left_since(self) -> list[str]:
        """Breaches: what is there now and was not then, after a little patience."""
        deadline = time.monotonic() + _GRACE_S
        while (left := self._left()) and time.monotonic() < deadline:
            time.sleep(0.01)
        return left

    def _left(self) -> list[str]:
        threads = frozenset(threading.enumerate()) - self.threads
        files = _files() - self.files
        return [f"thread {thread.name} left behind" for thread in threads] + [
            f"{count} open file(s) left behind: {name}" for name, count in files.items()
        ]


def resident_bytes() -> int:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _files() -> Counter[str]:
    files: Counter[str] = Counter()
    for number in os.listdir("/proc/self/fd"):
        try:
            files[os.readlink(f"/proc/self/fd/{number}").rsplit(":", 1)[0]] += 1
        except FileNotFoundError:
            continue  # the folder's own, closed by now
    return files
