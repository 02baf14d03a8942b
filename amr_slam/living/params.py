"""How changes are watched, and which of them a robot may accept by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchParams:
    """Localization: what has changed is watched, and kept beside the map's file."""

    watch: bool = True
    """False watches nothing."""
    range_m: Annotated[float, Gt(0.0), Le(25.0)] = 8.0
    """Farther away, a small error of the heading looks like a change."""
    standing_s: Annotated[float, Ge(0.0), Le(3600.0)] = 6.0
    """What is new must be seen standing this long in one pass: people walk on."""
    apart_s: Annotated[float, Gt(0.0), Le(86400.0)] = 120.0
    """A place that was out of sight for so long is seen in another pass;"""
    longest_s: Annotated[float, Gt(0.0), Le(86400.0)] = 900.0
    """one that stays in sight, after this."""
    passes: Annotated[int, Ge(1), Le(1000)] = 2
    """A change is told once so many passes in a row have shown it."""
    most_cells: Annotated[int, Ge(100), Le(1_000_000)] = 30_000
    """Bounds memory and file: cells of new and of gone things each; the least certain go first."""
    save_period_s: Annotated[float, Ge(10.0), Le(86400.0)] = 300.0
    """What was seen is written this often: what a power cut may cost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptPolicy:
    """Changes that are accepted without a person. Off unless ``passes`` is set."""

    passes: Annotated[int, Ge(0), Le(1000)] = 0
    """Accept what so many passes in a row have shown; 0 accepts nothing by itself."""
    age_h: Annotated[float, Ge(0.0), Le(10_000.0)] = 24.0
    """... and what was first seen at least this many hours before it was seen last."""
    area_m2: Annotated[float, Gt(0.0), Le(10_000.0)] = 10.0
    """... and what is not larger than this: larger changes are for a person."""
    keep: Annotated[int, Ge(1), Le(9)] = 9
    """Older versions of the map that stay beside it."""
