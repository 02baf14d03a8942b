"""What the kernel knows of the daemon's processes."""

from __future__ import annotations

import os
from pathlib import Path


def slam_process(daemon: int) -> int | None:
    """The SLAM process of a daemon; multiprocessing's other child is its resource tracker."""
    children = Path(f"/proc/{daemon}/task/{daemon}/children").read_text("ascii").split()
    for child in children:
        try:
            command = Path(f"/proc/{child}/cmdline").read_bytes()
        except OSError:  # it has ended meanwhile
            continue
        if b"spawn_main" in command:
            return int(child)
    return None


def open_files(pid: int) -> int:
    """File descriptors, sockets included."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def has_ended(pid: int) -> bool:
    """Gone, or a zombie that somebody else has to bury."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"
