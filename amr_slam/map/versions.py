"""A map file that cannot be used, and the older versions beside it."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from amr_slam.map.file import MapError, load_map
from amr_slam.map.pointmap import PointMap

_MOST: Final = 9


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
    for number in range(1, _MOST + 1):
        older = path.with_name(f"{path.name}.{number}")
        try:
            grown, map_id = load_map(older)
        except MapError:
            continue
        complaint = f"{first}; using {older.name}, an older map"
        return LoadedMap(map=grown, map_id=map_id, path=older, complaint=complaint)
    raise first
