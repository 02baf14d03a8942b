"""What people have drawn over a map: kept beside what scanners saw, never burnt in.

A layer that is removed stays in the file until there is no room for it: nothing that somebody drew
is lost by a slip, and the last step can be undone.
"""

from __future__ import annotations

import enum
import math
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from amr_slam import areas
from amr_slam.areas import Area
from amr_slam.geometry import Array, Pose2, readonly

MAX_LAYERS: Final = 256
MAX_CORNERS: Final = 1000
"""Of one layer."""
MAX_ALL_CORNERS: Final = 10_000
"""Of all of a map's layers: its file's header is bounded."""
MAX_WALLS_M: Final = 10_000.0
"""Of drawn walls in a map."""
_MAX_TEXT: Final = 60
_FARTHEST_M: Final = 1e5
_LEAST_AREA_M2: Final = 1e-4


class LayerError(Exception):
    """A layer that cannot be; the message says what is wrong with it."""


class LayerKind(enum.StrEnum):
    """What a layer does to a map."""

    ERASE = "erase"
    """Polygon: what scanners saw here is not there."""
    WALL = "wall"
    """Polyline: here stands a wall."""
    ZONE = "zone"
    """Polygon: what is here is no landmark. Neither map points nor scan points in it are used."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Edit:
    """One step of somebody's work on a map."""

    step: int
    """1, 2, ... in the order of the steps; several layers may belong to one."""
    by: str
    at_s: int
    """UTC."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """A polygon or polyline over the map."""

    kind: LayerKind
    layer_id: uuid.UUID
    name: str
    corners_m: Array
    """(n, 2) in the map frame; read-only. Polygons are closed from the last to the first."""
    added: Edit
    removed: Edit | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners_m", readonly(self.corners_m))


class Layers:
    """All layers of a map, those that were removed included; immutable."""

    def __init__(self, everything: Sequence[Layer] = ()) -> None:
        """Raises LayerError where these cannot be a map's layers."""
        _check_together(everything)
        self.everything = tuple(everything)

    def __len__(self) -> int:
        return len(self.active)

    def __bool__(self) -> bool:
        return bool(self.active)

    @property
    def active(self) -> tuple[Layer, ...]:
        return tuple(one for one in self.everything if one.removed is None)

    def areas(self, kind: LayerKind) -> tuple[Area, ...]:
        """The polygons of a kind."""
        return tuple(
            Area(name=one.name, corners_m=one.corners_m) for one in self.active if one.kind is kind
        )

    def with_drawn(
        self, drawn: Sequence[tuple[LayerKind, str, Array]], by: str, at_s: int
    ) -> Layers:
        """One step that adds (kind, name, corners (n, 2)) each. Raises LayerError."""
        edit = Edit(step=self._next_step, by=_text(by, "who drew it"), at_s=at_s)
        fresh = [
            Layer(kind=kind, layer_id=uuid.uuid4(), name=name, corners_m=corners, added=edit)
            for kind, name, corners in drawn
        ]
        for one in fresh:
            check(one)
        kept = list(self.everything)
        # What was removed goes first where room is needed, the oldest of it first.
        for one in sorted(kept, key=lambda one: one.removed.step if one.removed else 0):
            if one.removed is not None and not _fit([*kept, *fresh]):
                kept.remove(one)
        return Layers([*kept, *fresh])

    def without(self, names: Sequence[str], by: str, at_s: int) -> Layers:
        """One step that removes layers by name or UUID. Raises LayerError."""
        edit = Edit(step=self._next_step, by=_text(by, "who removes it"), at_s=at_s)
        gone = [self._find(name) for name in names]
        return Layers(
            [replace(one, removed=edit) if one in gone else one for one in self.everything]
        )

    def undone(self) -> tuple[Layers, str]:
        """As before the last step, and what that was, in words. Raises LayerError."""
        last = self._next_step - 1
        if not last:
            raise LayerError("there is no step to undo")
        told: list[str] = []
        kept: list[Layer] = []
        for one in self.everything:
            if one.removed is not None and one.removed.step == last:
                told.append(f'{one.kind} "{one.name}" is back')
                kept.append(replace(one, removed=None))
            elif one.added.step == last:
                told.append(f'{one.kind} "{one.name}" is gone')
            else:
                kept.append(one)
        return Layers(kept), ", ".join(told)

    def moved(self, new_from_old: Pose2) -> Layers:
        """The same on a map in another frame."""
        return Layers(
            [replace(one, corners_m=new_from_old @ one.corners_m) for one in self.everything]
        )

    @property
    def _next_step(self) -> int:
        edits = [edit for one in self.everything for edit in (one.added, one.removed) if edit]
        return 1 + max((edit.step for edit in edits), default=0)

    def _find(self, name: str) -> Layer:
        for one in self.active:
            if name in {one.name, str(one.layer_id)}:
                return one
        known = ", ".join(f'"{one.name}"' for one in self.active[:10])
        raise LayerError(f'there is no layer "{name}"; there are: {known or "none"}')


def check(layer: Layer) -> None:
    """Raises LayerError: which layer, and what is wrong with it."""
    told = f'{layer.kind} "{layer.name}"'
    _text(layer.name, "a layer's name")
    corners = layer.corners_m
    least = 2 if layer.kind is LayerKind.WALL else 3
    if corners.ndim != 2 or corners.shape[1] != 2 or not least <= len(corners) <= MAX_CORNERS:
        raise LayerError(f"{told}: needs {least} to {MAX_CORNERS} points X,Y")
    if not np.all(np.abs(corners) <= _FARTHEST_M):
        raise LayerError(f"{told}: points must be numbers of m, 100 km off at most")
    if layer.kind is LayerKind.WALL:
        if areas.length_m(corners) <= 0.0:
            raise LayerError(f"{told}: all its points are one")
        return
    crossed = areas.crossing(corners)
    if crossed is not None:
        i, j = crossed
        raise LayerError(
            f"{told}: its edges cross: the one from point {i + 1} {_point(corners[i])} meets the "
            f"one from point {j + 1} {_point(corners[j])}; draw two polygons, or name the points "
            "in order around it"
        )
    if areas.area_m2(corners) < _LEAST_AREA_M2:
        raise LayerError(f"{told}: it holds no area")


def to_header(layers: Layers) -> list[dict[str, Any]]:
    """What stands in a map file's header, and what ``amr-slam map edit MAP list --json`` tells."""
    return [
        {
            "kind": str(one.kind),
            "uuid": str(one.layer_id),
            "name": one.name,
            "points_m": [[float(x), float(y)] for x, y in one.corners_m],
            "added": _edit_to_header(one.added),
            "removed": None if one.removed is None else _edit_to_header(one.removed),
        }
        for one in layers.everything
    ]


def from_header(raw: object) -> Layers:
    """The other way. Raises ValueError, TypeError or KeyError for anything else."""
    if not isinstance(raw, list) or len(raw) > MAX_LAYERS:
        raise ValueError(f"layers must be a list of at most {MAX_LAYERS}")
    try:
        everything = [_layer_from_header(entry) for entry in raw]
        for one in everything:
            check(one)
        return Layers(everything)
    except LayerError as error:
        raise ValueError(f"layer {error}") from error


def corners_from(raw: object) -> Array:
    """(n, 2) of lists of two numbers. Raises ValueError."""
    if not isinstance(raw, list) or len(raw) > MAX_CORNERS:
        raise ValueError(f"points must be a list of at most {MAX_CORNERS} pairs of numbers")
    pairs = [pair if isinstance(pair, list) else [] for pair in raw]
    if not all(len(pair) == 2 and all(_is_number(one) for one in pair) for pair in pairs):
        raise ValueError("points must be pairs of finite numbers")
    return np.array(pairs, dtype=np.float64).reshape(-1, 2)


def _layer_from_header(entry: Any) -> Layer:
    removed = entry["removed"]
    return Layer(
        kind=LayerKind(entry["kind"]),
        layer_id=uuid.UUID(str(entry["uuid"])),
        name=_text(entry["name"], "a layer's name"),
        corners_m=corners_from(entry["points_m"]),
        added=_edit_from_header(entry["added"]),
        removed=None if removed is None else _edit_from_header(removed),
    )


def _edit_to_header(edit: Edit) -> dict[str, Any]:
    return {"step": edit.step, "by": edit.by, "at_s": edit.at_s}


def _edit_from_header(entry: Any) -> Edit:
    step, at_s = entry["step"], entry["at_s"]
    if not (type(step) is int and 0 < step < 2**31 and type(at_s) is int and 0 <= at_s < 2**40):
        raise ValueError("a layer's step and time must be whole numbers")
    return Edit(step=step, by=_text(entry["by"], "who drew a layer"), at_s=at_s)


def _check_together(everything: Sequence[Layer]) -> None:
    active = [one for one in everything if one.removed is None]
    names = [one.name for one in active]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise LayerError(f'there are two layers named "{twice}"; give each a name of its own')
    if len({one.layer_id for one in everything}) < len(everything):
        raise LayerError("two layers have the same UUID")
    if not _fit(everything):
        raise LayerError(
            f"more than a map may have: {MAX_LAYERS} layers, {MAX_ALL_CORNERS} points, "
            f"{MAX_WALLS_M / 1000.0:g} km of walls"
        )


def _fit(everything: Sequence[Layer]) -> bool:
    walls_m = sum(
        areas.length_m(one.corners_m)
        for one in everything
        if one.kind is LayerKind.WALL and one.removed is None
    )
    corners = sum(len(one.corners_m) for one in everything)
    return len(everything) <= MAX_LAYERS and corners <= MAX_ALL_CORNERS and walls_m <= MAX_WALLS_M


def _text(value: object, what: str) -> str:
    if not (isinstance(value, str) and 0 < len(value) <= _MAX_TEXT and value.isprintable()):
        raise LayerError(f"{what} must be 1 to {_MAX_TEXT} printable characters")
    return value


def _is_number(value: object) -> bool:
    if type(value) is int:
        return abs(value) < 2**53
    return type(value) is float and math.isfinite(value)


def _point(corner: Array) -> str:
    return f"({corner[0]:g}, {corner[1]:g})"
