"""What commands write, and arguments that cannot be done."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class UsageError(Exception):
    """Arguments that do not go together, or not with the log that they name."""


def check_outputs(*paths: Path | None, source: Path) -> None:
    """Refuse before the work what cannot be written after it, or would overwrite the source.

    Raises UsageError.
    """
    given = [path for path in paths if path is not None]
    for path in given:
        if not path.parent.is_dir():
            raise UsageError(f"{path}: there is no folder {path.parent}")
        if path.is_dir():
            raise UsageError(f"{path}: is a folder")
        if path.resolve() == source.resolve():
            raise UsageError(f"{path}: is what is read; name another file for the output")
    if len({path.resolve() for path in given}) < len(given):
        raise UsageError(f"{given[0]}: named for two outputs")


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """Let every OSError from within name the file: a full disk does not by itself."""
    try:
        yield path
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
