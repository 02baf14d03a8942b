"""A simulated room with its map file, in the room's own frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from amr_slam.map.file import save_map
from amr_slam.params import SlamParams
from amr_slam.simulation import (
    ScannerModel,
    Tour,
    World,
    laboratory,
    mapping_poses,
    plan_tour,
    symmetric,
)
from amr_slam.studies.scenes import Scene

_WORLDS: Final[dict[str, Callable[[], World]]] = {
    "laboratory": lambda: laboratory(7),
    "alike": lambda: symmetric(2, 200.0),
}
_MAPPER: Final = ScannerModel(sigma_range_m=0.01)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """Where a robot drives."""

    world: World
    tour: Tour
    map_path: Path
    """Of a map made at true poses: poses in it are ``world_from_base``."""


def mapped(kind: str, folder: Path) -> Place:
    """The ``laboratory``, or a hall that is ``alike`` after half a turn; its map is written into
    ``folder``. Raises KeyError for another kind, MapError when it cannot be written."""
    world = _WORLDS[kind]()
    known = Scene.of(world, kind, mapping_poses(world)).map_at_truth(_MAPPER, SlamParams())
    known.name = kind
    path = folder / f"{kind}.amrmap"
    save_map(known, path)
    return Place(world=world, tour=plan_tour(world), map_path=path)
