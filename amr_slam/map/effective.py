"""The map that counts: what scanners saw, less what people erased, and the walls they drew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from amr_slam import areas
from amr_slam.areas import Area
from amr_slam.geometry import Array
from amr_slam.map.grid import SparseGrid
from amr_slam.map.layers import LayerKind, Layers
from amr_slam.registration.alignment import Target


def edited(seen: Target, layers: Layers) -> Target:
    """``seen`` with the layers over it, zones excepted. Erased is what was seen, never a wall that
    was drawn. Where a drawn wall stands nothing counts as seen free."""
    gone = layers.areas(LayerKind.ERASE)
    kept = ~areas.within(seen.points_m, gone)
    points, normals = drawn_walls(layers, seen.spacing_m)
    under = SparseGrid(seen.cell_m, 1).keys_of(points)
    free = SparseGrid(seen.cell_m, 1).keys_of(np.asarray(seen.free_m, dtype=np.float64))
    return replace(
        seen,
        points_m=np.concatenate([seen.points_m[kept], points]),
        normals=np.concatenate([seen.normals[kept], normals]),
        free_m=seen.free_m[~np.isin(free, under)],
    )


def drawn_walls(layers: Layers, spacing_m: float) -> tuple[Array, Array]:
    """Points (n, 2) and normals (n, 2) of the walls that were drawn, each with both its sides."""
    sides = [
        areas.along(one.corners_m, spacing_m) for one in layers.active if one.kind is LayerKind.WALL
    ]
    points = [np.empty((0, 2)), *(side for side, _ in sides for _ in range(2))]
    normals = [np.empty((0, 2)), *(turn * normal for _, normal in sides for turn in (1.0, -1.0))]
    return np.concatenate(points), np.concatenate(normals)


def landmarks(whole: Target, zones: Sequence[Area]) -> Target:
    """What of the map scans may be registered against; the zones come along, so that what a scan
    sees in them is left out too."""
    return replace(
        whole,
        points_m=whole.points_m[~areas.within(whole.points_m, zones)],
        normals=whole.normals[~areas.within(whole.points_m, zones)],
        free_m=whole.free_m[~areas.within(whole.free_m, zones)],
        zones=tuple(zones),
    )
