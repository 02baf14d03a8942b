"""The YAML file beside a picture of a map, as map servers write and read it: flat, few keys.

Source: nav2_map_server, map_io.cpp: keys, their defaults, and what the modes mean.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, cast

from amr_slam.geometry import Pose2
from amr_slam.map.file import MapError

Mode = Literal["trinary", "scale", "raw"]

_MAX_BYTES: Final = 65_536
_ENTRY: Final = re.compile(r"^(\w+)[ \t]*:[ \t]*(.*)$")
_ITEM: Final = re.compile(r"^[ \t]*-[ \t]+(.*)$")
_RESOLUTIONS_M: Final = (1e-4, 10.0)
_FARTHEST_M: Final = 1e5
_FREE_DEFAULT, _OCCUPIED_DEFAULT = 0.25, 0.65


@dataclass(frozen=True, slots=True, kw_only=True)
class Described:
    """A picture of a map, as its YAML file describes it."""

    image: Path
    resolution_m: float
    """Side of a pixel."""
    map_from_corner: Pose2
    """The lower left corner of the picture, and how it is turned."""
    mode: Mode
    negate: bool
    """Dark is free."""
    occupied_thresh: float
    free_thresh: float


def read_description(path: Path) -> Described:
    """Raises MapError, which names file and key."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(_MAX_BYTES + 1)
        text = raw.decode()
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise MapError(f"{path}: is no text: a map server's YAML file is needed") from error
    if len(raw) > _MAX_BYTES:
        raise MapError(f"{path}: more than {_MAX_BYTES} bytes: a map server's YAML file is small")
    found = _entries(text)
    image = "".join(found.get("image", []))
    if not image:
        raise MapError(f"{path}: image: the picture's file must be named")
    return Described(
        image=path.parent / image,
        resolution_m=_number(path, found, "resolution", None, *_RESOLUTIONS_M),
        map_from_corner=_origin(path, found),
        mode=_mode(path, found),
        negate=_switch(path, found, "negate"),
        occupied_thresh=_number(path, found, "occupied_thresh", _OCCUPIED_DEFAULT, 0.0, 1.0),
        free_thresh=_number(path, found, "free_thresh", _FREE_DEFAULT, 0.0, 1.0),
    )


def _entries(text: str) -> dict[str, list[str]]:
    """Values of the keys at the left margin: one, or those of a list in either form of YAML."""
    found: dict[str, list[str]] = {}
    key = ""
    for line in text.splitlines():
        bare = re.sub(r"(^|[ \t])#.*$", "", line).rstrip()
        entry, item = _ENTRY.match(bare), _ITEM.match(bare)
        if entry is not None:
            key, value = entry.groups()
            listed = re.fullmatch(r"\[(.*)\]", value)
            parts = [value] if listed is None else listed.group(1).split(",")
            found[key] = [part.strip().strip("\"'") for part in parts if part.strip()]
        elif item is not None and key:
            found[key].append(item.group(1).strip())
    return found


def _number(
    path: Path,
    found: dict[str, list[str]],
    key: str,
    default: float | None,
    least: float,
    most: float,
) -> float:
    told = found.get(key, [])
    if not told and default is not None:
        return default
    value = _float(told[0]) if len(told) == 1 else math.nan
    if not least <= value <= most:
        raise MapError(
            f"{path}: {key}: {' '.join(told) or 'nothing'}: must be {least:g} to {most:g}"
        )
    return value


def _origin(path: Path, found: dict[str, list[str]]) -> Pose2:
    told = found.get("origin", [])
    numbers = [_float(part) for part in told]
    if len(numbers) != 3 or not all(abs(number) <= _FARTHEST_M for number in numbers):
        raise MapError(f"{path}: origin: [{', '.join(told)}]: must be [X, Y, YAW], in m and rad")
    return Pose2(*numbers)


def _mode(path: Path, found: dict[str, list[str]]) -> Mode:
    told = "".join(found.get("mode", [])) or "trinary"
    if told not in {"trinary", "scale", "raw"}:
        raise MapError(f"{path}: mode: {told}: must be trinary, scale or raw")
    return cast("Mode", told)


def _switch(path: Path, found: dict[str, list[str]], key: str) -> bool:
    told = "".join(found.get(key, [])).lower() or "0"
    if told not in {"0", "1", "true", "false"}:
        raise MapError(f"{path}: {key}: {told}: must be 0 or 1")
    return told in {"1", "true"}


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
