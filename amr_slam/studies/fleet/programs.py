"""What the programs of this package have in common: they begin with a line and end with one."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from typing import Any


def ready() -> None:
    """Tell who started this program that it is under way."""
    sys.stdout.write("ready\n")
    sys.stdout.flush()


def wait_for_end() -> threading.Event:
    """Set once standard input ends: then the program is to end."""
    ended = threading.Event()

    def read() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=read, daemon=True).start()
    return ended


def say(what: dict[str, Any]) -> None:
    """One line of JSON."""
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def memory_mb() -> float:
    """Resident memory of this process in MB (proc(5), VmRSS)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError("/proc/self/status has no VmRSS")
