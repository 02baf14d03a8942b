"""A map file that cannot be used, and the older versions beside it."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from amr_slam.durable import write_durably
from amr_slam.map.file import MapError, load_map
from amr_slam.map.pointmap import PointMap

MOST_VERSIONS: Final = 9
"""Older versions that may lie beside a map: NAME.amrmap.1 (the newest) to .9."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedMap:
    """A map and the file that it came from."""

    map: PointMap
    map_id: uuid.UUID
    path: Path
    complaint: str | None
    """Why it is an older version than the one that was asked for."""


def load_newest(path: Path) -> LoadedMap:
    """The map in ``path``, or in the newest of its older versions that can be used.

    Raises MapError, that of ``path`` itself, when there is none.
    """
    try:
        grown, map_id = load_map(path)
        return LoadedMap(map=grown, map_id=map_id, path=path, complaint=None)
    except MapError as error:
        first = error
    for number in range(1, MOST_VERSIONS + 1):
        older = version_path(path, number)
        try:
            grown, map_id = load_map(older)
        except MapError:
            continue
        complaint = f"{first}; using {older.name}, an older map"
        return LoadedMap(map=grown, map_id=map_id, path=older, complaint=complaint)
    raise first


def version_path(path: Path, number: int) -> Path:
    """Where the ``number``-th older version of the map in ``path`` lies."""
    return path.with_name(f"{path.name}.{number}")


def roll_back(path: Path, number: int) -> uuid.UUID:
    """Make an older version the map again; what it replaces becomes version 1, so that nothing is
    lost but the oldest of nine. Returns its UUID. Raises MapError."""
    older = version_path(path, number)
    _, map_id = load_map(older)
    kept = [n for n in range(1, MOST_VERSIONS + 1) if version_path(path, n).exists()]
    try:
        write_durably(path, older.read_bytes(), keep=min(max(kept) + 1, MOST_VERSIONS))
    except OSError as error:
        raise MapError(f"{path}: cannot write the map: {error.strerror or error}") from error
    return map_id
