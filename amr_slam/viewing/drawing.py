"""A map from the network as a page draws it. Done in a process of its own: whatever the bytes are,
they cost that process its memory and its time, and no page its poses."""

from __future__ import annotations

import base64
import json
import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.map import MapError, PointMap
from amr_slam.map.export import FREE, image_within, png_bytes
from amr_slam.map.file import decode

MAX_POINTS: Final = 120_000
"""What a browser draws in a frame or two; more are thinned evenly."""
_MAX_PIXELS: Final = 4_000_000


def drawn(data: bytes) -> bytes:
    """For the page: the length of a JSON header (u32, little endian), the header, and the wall
    points as float32 (n, 2) in m. The header has the floor as a PNG. Raises
    ValueError, one line, for bytes that are no map, or none that can be drawn."""
    try:
        known, map_id = decode(data)
        walls = thinned(known.target().points_m.astype("<f4"))
        header = {
            "id": str(map_id),
            "name": known.name,
            "points": len(walls),
            "all_points": len(known.target().points_m),
            "cell_m": known.params.cell_m,
            "bounds": known.bounds(),
            "area_m2": known.area_m2(),
            "floor": _floor(known),
            "layers": [
                {"kind": one.kind, "name": one.name, "points_m": one.corners_m.tolist()}
                for one in known.layers.active
            ],
        }
    except MapError as error:
        raise ValueError(str(error)) from error
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + walls.tobytes()


def thinned(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, 2), at most :data:`MAX_POINTS`: of a finer map every cell of the coarsest grid that
    holds few enough keeps its first point, so that no wall goes as a whole."""
    side_m = 0.05
    kept = points
    while len(kept) > MAX_POINTS:
        cells = np.floor(points / side_m).astype(np.int64)
        _, first = np.unique(cells, axis=0, return_index=True)
        kept = points[np.sort(first)]
        side_m *= 1.5
    return kept


def _floor(known: PointMap) -> dict[str, object]:
    image = image_within(known, known.space.cell_m, _MAX_PIXELS)
    rows, columns = image.pixels.shape
    return {
        "png": base64.b64encode(png_bytes(image)).decode(),
        "free": FREE,
        "x_min_m": image.x_min_m,
        "y_min_m": image.y_min_m,
        "cell_m": image.resolution_m,
        "columns": columns,
        "rows": rows,
    }
