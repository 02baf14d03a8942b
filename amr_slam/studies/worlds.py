"""The kinds and sizes of worlds over which cost and success are shown."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Final

from amr_slam.simulation import (
    ScannerModel,
    World,
    corridors,
    hall,
    odd,
    offices,
    plan_tour,
    symmetric,
)
from amr_slam.studies.scenes import MAPPING_SCANS, S300, Scene, along

KINDS: Final[dict[str, Callable[[int, float], World]]] = {
    "hall": hall,
    "offices": offices,
    "corridors": corridors,
    "odd": odd,
    "symmetric": symmetric,
}
AREAS_M2: Final[dict[str, tuple[float, ...]]] = {
    "hall": (50.0, 200.0, 1000.0, 5000.0, 10_000.0),
    "offices": (200.0, 1000.0, 3000.0),
    "corridors": (200.0, 1000.0),
    "odd": (200.0, 1000.0),
    "symmetric": (200.0, 1000.0),
}

# Mapping scans in large worlds are this far apart on the way.
_SPACING_M = 1.5
_STEP_M = 0.05


@functools.lru_cache(maxsize=8)
def _world(kind: str, seed: int, area_m2: float) -> World:
    return KINDS[kind](seed, area_m2)


def scene_of(kind: str, seed: int, area_m2: float, scanner: ScannerModel = S300) -> Scene:
    """A world mapped along a tour of it all: 85 scans, or one every 1.5 m if that is more."""
    world = _world(kind, seed, area_m2)
    path = plan_tour(world).path_m
    scans = max(MAPPING_SCANS, round(len(path) * _STEP_M / _SPACING_M))
    return Scene.of(world, kind, along(path, scans), scanner)
