"""Files of a site's folder, read bounded and written whole."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Final

MAX_BYTES: Final = 4 * 1024 * 1024


class KeysError(Exception):
    """What cannot be done to a site's keys: one line that names the file or the member."""


def read(path: Path) -> bytes:
    """No more than ``MAX_BYTES`` of it. Raises KeysError."""
    try:
        with path.open("rb") as stream:
            return stream.read(MAX_BYTES)
    except OSError as error:
        raise KeysError(f"{path}: {error.strerror}") from error


def write(path: Path, content: bytes, *, private: bool = False) -> None:
    """Whole or not at all; private files are never readable by others, not even for a moment."""
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, fresh = tempfile.mkstemp(dir=path.parent)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
        os.fchmod(stream.fileno(), 0o600 if private else 0o644)
    os.replace(fresh, path)
