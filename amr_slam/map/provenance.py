"""Where a map's frame comes from: kept in the map's file, told by ``map info``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Final

from amr_slam.geometry import Pose2

MAX_REFRAMINGS: Final = 16
"""A map's file tells the last ones; its header is bounded."""
MAX_MERGED: Final = 64
_MAX_TEXT: Final = 200
_MAX_ERROR_M: Final = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Reframing:
    """A map was brought into another frame."""

    map_id: str
    """UUID of the map that it was before."""
    by: str
    """By what the frames were brought together, in a few words."""
    x_m: float
    """Site frame from the map's old frame ..."""
    y_m: float
    theta_rad: float
    rms_m: float
    """Of what was left between both."""
    used: int
    """Number of pairs or points that it rests on ..."""
    left_out: int
    """... and of those that contradicted the others."""
    scale: float
    """Site over map, as measured; never applied: a map is as large as its scanners say."""

    @property
    def site_from_map(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.theta_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class Merged:
    """Another map's scans joined a map, all at once."""

    map_id: str
    """UUID of that map ..."""
    name: str
    """... and its name."""
    x_m: float
    """The frame of then from that map's ..."""
    y_m: float
    theta_rad: float
    rms_m: float
    """How far its scans were found from where that motion has them."""
    scans: int
    """That joined; they come last in the path, before what joined later."""
    common_m2: float
    """Floor that both had seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """A map began as another program's picture."""

    source: str
    """The picture's name."""
    resolution_m: float
    """Side of its pixels."""
    error_m: float
    """How far the walls may lie from where the picture has them."""


def imported_from_header(raw: object) -> Imported | None:
    """What :func:`asdict` made of it, or None. Raises ValueError, TypeError or KeyError."""
    if raw is None:
        return None
    known = {field.name: raw[field.name] for field in fields(Imported)}  # type: ignore[index]
    source, numbers = known["source"], [known["resolution_m"], known["error_m"]]
    if not (isinstance(source, str) and len(source) <= _MAX_TEXT) or not all(
        type(number) in {int, float} and 0.0 < number <= _MAX_ERROR_M for number in numbers
    ):
        raise ValueError("where a map was imported from must be told in a text and lengths in m")
    return Imported(**known)


def merged_to_header(merged: Sequence[Merged]) -> list[dict[str, Any]]:
    """What stands in a map file's header, oldest first."""
    return [asdict(one) for one in merged[-MAX_MERGED:]]


def merged_from_header(raw: object) -> tuple[Merged, ...]:
    """The other way. Raises ValueError, TypeError or KeyError for anything else."""
    if not isinstance(raw, list) or len(raw) > MAX_MERGED:
        raise ValueError(f"merged must be a list of at most {MAX_MERGED}")
    return tuple(Merged(**_told(entry, Merged, ("map_id", "name"), ("scans",))) for entry in raw)


def to_header(reframings: Sequence[Reframing]) -> list[dict[str, Any]]:
    """What stands in a map file's header, oldest first."""
    return [asdict(one) for one in reframings[-MAX_REFRAMINGS:]]


def from_header(raw: object) -> tuple[Reframing, ...]:
    """The other way. Raises ValueError, TypeError or KeyError for anything else."""
    if not isinstance(raw, list) or len(raw) > MAX_REFRAMINGS:
        raise ValueError(f"reframings must be a list of at most {MAX_REFRAMINGS}")
    return tuple(
        Reframing(**_told(entry, Reframing, ("map_id", "by"), ("used", "left_out")))
        for entry in raw
    )


def _told(
    entry: Any, kind: type[Reframing | Merged], texts: Sequence[str], counts: Sequence[str]
) -> dict[str, Any]:
    """The fields of ``kind``, of which all but ``texts`` and ``counts`` are numbers. What a newer
    version adds is none of ours."""
    known = {field.name: entry[field.name] for field in fields(kind)}
    numbers = [known[name] for name in known if name not in {*texts, *counts}]
    if not (
        all(isinstance(known[name], str) and len(known[name]) <= _MAX_TEXT for name in texts)
        and all(type(number) in {int, float} and math.isfinite(number) for number in numbers)
        and all(type(known[name]) is int and known[name] >= 0 for name in counts)
    ):
        raise ValueError("where a map comes from must be told in texts and finite numbers")
    return known
