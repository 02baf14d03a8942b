"""The map in other programs' formats: occupancy image, points, pose graph."""

from __future__ import annotations

import json
import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amr_slam.geometry import Array
from amr_slam.map.file import MapError
from amr_slam.map.pointmap import PointMap

# Grey values of the map server's trinary mode: (255 - grey) / 255 against the two thresholds.
OCCUPIED, UNKNOWN, FREE = 0, 205, 254
_OCCUPIED_THRESHOLD, _FREE_THRESHOLD = 0.65, 0.196
_MAX_PIXELS = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OccupancyImage:
    """The map as pixels: walls, seen floor, unknown."""

    pixels: NDArray[np.uint8]
    """(rows, columns) of OCCUPIED, FREE or UNKNOWN; the first row has the greatest y."""
    resolution_m: float
    """Side of a pixel."""
    x_min_m: float
    """Left edge in the map frame."""
    y_min_m: float
    """Lower edge in the map frame."""


def occupancy_image(grown: PointMap, resolution_m: float | None = None) -> OccupancyImage:
    """The map as pixels of ``resolution_m``, by default as far apart as its wall points.

    Raises MapError beyond 100 million pixels.
    """
    resolution = resolution_m or grown.spacing_m
    whole = grown.surfaces()
    walls = whole.points_m
    floor = _spread(whole.free_m.astype(np.float64), grown.space.cell_m, resolution)
    everything = np.concatenate([walls, floor])
    if not len(everything):
        everything = np.zeros((1, 2))
    low = np.floor(everything.min(axis=0) / resolution) - 1.0
    high = np.floor(everything.max(axis=0) / resolution) + 2.0
    columns, rows = (int(side) for side in high - low)
    if rows * columns > _MAX_PIXELS:
        raise MapError(f"{columns} x {rows} pixels are more than an image may have")
    pixels = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    for points, grey in ((floor, FREE), (walls, OCCUPIED)):
        column, row = (np.floor(points / resolution) - low).astype(np.int64).T
        pixels[rows - 1 - row, column] = grey
    return OccupancyImage(
        pixels=pixels,
        resolution_m=resolution,
        x_min_m=float(low[0]) * resolution,
        y_min_m=float(low[1]) * resolution,
    )


def image_within(grown: PointMap, resolution_m: float | None, max_pixels: int) -> OccupancyImage:
    """The map as pixels of ``resolution_m`` (None: of a wall cell), or of more where there would be
    more than ``max_pixels``."""
    x_min, y_min, x_max, y_max = grown.bounds()
    least_m = math.sqrt((x_max - x_min + 1.0) * (y_max - y_min + 1.0) / max_pixels)
    return occupancy_image(grown, max(resolution_m or grown.spacing_m, least_m))


def png_bytes(image: OccupancyImage) -> bytes:
    """A greyscale PNG file of an image. Source: ISO/IEC 15948, 5 (chunks), 6.2 and 11.2."""
    rows, columns = image.pixels.shape
    header = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    unfiltered = np.zeros((rows, 1), dtype=np.uint8)  # each row begins with its filter's number
    content = zlib.compress(np.hstack([unfiltered, image.pixels]).tobytes(), 6)
    chunks = ((b"IHDR", header), (b"IDAT", content), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(name, data) for name, data in chunks)


def png_pixels(png: bytes) -> NDArray[np.uint8]:
    """(rows, columns) of what :func:`png_bytes` wrote, not of any other file."""
    columns, rows = struct.unpack_from(">II", png, 16)
    (size,) = struct.unpack_from(">I", png, 33)
    content = zlib.decompress(png[41 : 41 + size])
    return np.frombuffer(content, dtype=np.uint8).reshape(rows, columns + 1)[:, 1:]


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def _spread(centres: Array, cell_m: float, pixel_m: float) -> Array:
    """Points (n, 2) no farther apart than a pixel over the whole of each cell."""
    per_side = math.ceil(cell_m / pixel_m - 1e-9)
    steps = ((np.arange(per_side) + 0.5) / per_side - 0.5) * cell_m
    x, y = np.meshgrid(steps, steps)
    offsets = np.column_stack([x.ravel(), y.ravel()])
    spread: Array = (centres[:, None, :] + offsets[None, :, :]).reshape(-1, 2)
    return spread


def write_occupancy(
    grown: PointMap, path: Path, resolution_m: float | None = None
) -> tuple[OccupancyImage, Path]:
    """``path`` (.pgm) and the YAML file beside it, as nav2's map server reads them.

    Returns the image and the YAML file's path. Raises MapError and OSError.
    Source: nav2_map_server, map_io.cpp: keys of the YAML file and the trinary mode.
    """
    image = occupancy_image(grown, resolution_m)
    rows, columns = image.pixels.shape
    path.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + image.pixels.tobytes())
    described = path.with_suffix(".yaml")
    lines = [
        f"image: {json.dumps(path.name)}",
        "mode: trinary",
        f"resolution: {image.resolution_m:g}",
        f"origin: [{image.x_min_m:.6f}, {image.y_min_m:.6f}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {_OCCUPIED_THRESHOLD}",
        f"free_thresh: {_FREE_THRESHOLD}",
    ]
    described.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return image, described


def write_points_csv(grown: PointMap, path: Path) -> int:
    """Wall points in m and their unit normals (0 where unknown); returns how many.

    Raises OSError.
    """
    rows = _points_and_normals(grown)
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write("x_m,y_m,normal_x,normal_y\n")
        np.savetxt(stream, rows, fmt="%.4f", delimiter=",")
    return len(rows)


def write_points_ply(grown: PointMap, path: Path) -> int:
    """The same as an ASCII PLY cloud at z = 0; returns the number of points. Raises OSError."""
    rows = _points_and_normals(grown)
    zeros = np.zeros((len(rows), 1))
    names = ("x", "y", "z", "nx", "ny", "nz")
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n")
        stream.writelines(f"property float {name}\n" for name in names)
        stream.write("end_header\n")
        np.savetxt(stream, np.hstack([rows[:, :2], zeros, rows[:, 2:], zeros]), fmt="%.4f")
    return len(rows)


def write_graph(grown: PointMap, path: Path) -> tuple[int, int]:
    """The pose graph as g2o reads it: the scans' poses, the first one fixed, and what is known of
    pairs of them. Returns the numbers of poses and of pairs.

    Raises MapError for a map without a graph, and OSError. Source: g2o, types/slam2d.
    """
    ties = grown.ties
    if not len(ties):
        raise MapError(
            "the map holds no pose graph: it was not made here from nothing, or by an older version"
        )
    rows, columns = np.triu_indices(3)
    with path.open("w", encoding="ascii", newline="\n") as stream:
        for row, (_, pose) in enumerate(grown.path):
            stream.write(f"VERTEX_SE2 {row} {pose.x_m:.9g} {pose.y_m:.9g} {pose.theta_rad:.9g}\n")
        stream.write("FIX 0\n")
        for start, end, delta, information in zip(
            ties.starts, ties.ends, ties.deltas, ties.informations, strict=True
        ):
            numbers = " ".join(f"{x:.9g}" for x in (*delta, *information[rows, columns]))
            stream.write(f"EDGE_SE2 {start} {end} {numbers}\n")
    return len(grown.path), len(ties)


def _points_and_normals(grown: PointMap) -> Array:
    target = grown.surfaces()
    return np.hstack([target.points_m, target.normals])
