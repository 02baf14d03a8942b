"""Files that survive: after a crash, a kill or a power cut, the old content or the new one, whole.

Written beside the target, synced, renamed over it, and the folder synced. What a killed writer
has left behind is cleared away by the next one.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def write_durably(path: Path, data: bytes, *, keep: int = 0) -> None:
    """Replace ``path`` by ``data``; the ``keep`` newest old versions stay as NAME.1, NAME.2, ...

    At no moment is ``path`` missing or anything but whole. Raises OSError; then the old content
    is still there, and nothing else is.
    """
    _make_folder(path.parent)
    _clear(path)
    fresh = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        _write(fresh, data)
        _rotate(path, keep)
        os.replace(fresh, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(fresh)
        raise
    sync_folder(path.parent)


def remove_durably(path: Path) -> None:
    """Forget ``path``, which may be missing. Raises OSError."""
    try:
        os.unlink(path)
    except FileNotFoundError:
        return
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Wait until the disk has the folder's names. Raises OSError."""
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def _write(path: Path, data: bytes) -> None:
    opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    try:
        left = memoryview(data)
        while left:
            left = left[os.write(opened, left) :]
        os.fsync(opened)
    finally:
        os.close(opened)


def _rotate(path: Path, keep: int) -> None:
    """Shift older versions by one; the current file is linked, so it never goes missing."""
    for number in range(keep, 1, -1):
        with contextlib.suppress(FileNotFoundError):
            os.replace(f"{path}.{number - 1}", f"{path}.{number}")
    if keep:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(f"{path}.1")
        with contextlib.suppress(FileNotFoundError):
            os.link(path, f"{path}.1")


def _make_folder(folder: Path) -> None:
    """With its parents, each of which the disk then has."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for made in missing:
        sync_folder(made.parent)


def _clear(path: Path) -> None:
    """Remove what writers that are gone have left behind."""
    for left in path.parent.glob(f".{path.name}.*.tmp"):
        writer = left.name.removesuffix(".tmp").rpartition(".")[2]
        if writer.isdecimal() and not _runs(int(writer)):
            left.unlink(missing_ok=True)


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True
