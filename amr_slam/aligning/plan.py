"""A floor plan's picture as points on the faces of its walls."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from amr_slam.aligning.pairs import AlignError
from amr_slam.geometry import Array, Pose2, readonly

_MAX_PIXELS: Final = 100_000_000
_DARK: Final = 0.5
"""Darker than this share of black is wall."""
_SPACING_M: Final = 0.05
_MAX_YAML_BYTES: Final = 65_536
_NUMBER: Final = r"[-+0-9.eE]+"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FloorPlan:
    """Faces of walls in the site's frame; arrays are read-only and row-aligned."""

    points_m: Array
    """(n, 2) no nearer to each other than 5 cm, about."""
    normals: Array
    """(n, 2) unit normals, out of the wall."""
    resolution_m: float
    """Side of a pixel."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_m", readonly(self.points_m))
        object.__setattr__(self, "normals", readonly(self.normals))


def read_plan(path: Path, resolution_m: float | None, origin: Pose2 | None) -> FloorPlan:
    """Dark lines and areas of a picture (PNG, PGM, JPEG, ...), or what a YAML file of nav2's map
    server describes, which knows resolution and origin itself.

    ``origin``: where the lower left corner of the picture lies in the site's frame, and how it is
    turned there. Raises AlignError.
    """
    dark = _DARK
    negate = False
    if path.suffix in {".yaml", ".yml"}:
        picture, told_m, told_origin, dark, negate = _described(path)
        resolution_m, origin = resolution_m or told_m, origin or told_origin
        path = picture
    if resolution_m is None or not 1e-4 <= resolution_m <= 10.0:
        raise AlignError(f"{path}: what is a pixel in m? --resolution M, 0.0001 to 10")
    darkness = _darkness(path)
    walls = (1.0 - darkness if negate else darkness) > dark
    points, normals = _faces(walls, resolution_m)
    if len(points) < 20:
        raise AlignError(f"{path}: there is nothing dark in it that could be walls")
    site_from_plan = origin or Pose2.identity()
    return FloorPlan(
        points_m=site_from_plan @ points,
        normals=normals @ site_from_plan.rotation.T,
        resolution_m=resolution_m,
    )


def _darkness(path: Path) -> NDArray[np.float32]:
    """(rows, columns) 0 white, 1 black; what is transparent is paper."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as picture:
                width, height = picture.size
                if width * height > _MAX_PIXELS:
                    raise AlignError(
                        f"{path}: {width} x {height} pixels, at most {_MAX_PIXELS}: shrink it"
                    )
                layered = picture.convert("RGBA")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise AlignError(f"{path}: not a picture that can be read: {error}") from error
    except Image.DecompressionBombWarning as error:
        raise AlignError(f"{path}: too many pixels: shrink it") from error
    paper = Image.new("RGBA", layered.size, "white")
    grey = Image.alpha_composite(paper, layered).convert("L")
    return np.asarray(1.0 - np.asarray(grey, dtype=np.float32) / 255.0)


def _faces(walls: NDArray[np.bool_], pixel_m: float) -> tuple[Array, Array]:
    """Points (n, 2) and normals (n, 2) where dark meets light, from the lower left corner."""
    blurred = gaussian_filter(walls.astype(np.float32), 1.5)
    slope_row, slope_column = np.gradient(blurred, axis=0), np.gradient(blurred, axis=1)
    padded = np.pad(walls, 1)
    points, normals = [], []
    rows = walls.shape[0]
    for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        beside = padded[1 + down : 1 + down + rows, 1 + right : 1 + right + walls.shape[1]]
        row, column = np.nonzero(walls & ~beside)
        x = column + 0.5 + 0.5 * right
        y = rows - row - 0.5 - 0.5 * down
        points.append(np.stack([x, y], axis=1) * pixel_m)
        out = np.stack([-slope_column[row, column], slope_row[row, column]], axis=1)
        # Of a line that is thin, the blur shows no side: then the side of the edge itself.
        side = np.array([right, -down], dtype=np.float64)
        along = out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
        clear = (along @ side) > 0.5
        normals.append(np.where(clear[:, None], along, side))
    return _thinned(np.concatenate(points), np.concatenate(normals))


def _thinned(points: Array, normals: Array) -> tuple[Array, Array]:
    """One point a cell and side of a wall."""
    if not len(points):
        return points, normals
    cell = np.floor(points / _SPACING_M).astype(np.int64)
    side = np.floor(np.arctan2(normals[:, 1], normals[:, 0]) / (0.5 * math.pi) + 0.5)
    key = np.column_stack([cell, side.astype(np.int64) % 4])
    _, row, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    row = row.ravel()
    mean = [
        np.stack([np.bincount(row, part) for part in table.T], axis=1) / count[:, None]
        for table in (points, normals)
    ]
    length = np.linalg.norm(mean[1], axis=1, keepdims=True)
    return mean[0], mean[1] / np.maximum(length, 1e-9)


def _described(path: Path) -> tuple[Path, float, Pose2, float, bool]:
    """Picture, resolution, origin, threshold and whether it is a negative, from the flat YAML
    files that map servers write. Source: nav2_map_server, map_io.cpp."""
    try:
        text = path.read_bytes()[: _MAX_YAML_BYTES + 1].decode()
    except (OSError, UnicodeDecodeError) as error:
        raise AlignError(f"{path}: cannot be read: {error}") from error
    found = dict(re.findall(r"^(\w+)[ \t]*:[ \t]*(.*?)[ \t]*(?:#.*)?$", text, re.MULTILINE))
    corner = re.fullmatch(
        rf"\[\s*({_NUMBER})\s*,\s*({_NUMBER})\s*,\s*({_NUMBER})\s*\]", found.get("origin", "")
    )
    try:
        resolution_m = float(found.get("resolution", ""))
        x_m, y_m, theta_rad = (
            (float(part) for part in corner.groups()) if corner else [math.nan] * 3
        )
        dark = float(found.get("occupied_thresh", _DARK))
        negate = int(found.get("negate", "0")) != 0
    except ValueError as error:
        raise AlignError(f"{path}: {error}") from error
    name = found.get("image", "").strip("\"'")
    if not name or not all(map(math.isfinite, (x_m, y_m, theta_rad, dark))):
        raise AlignError(f"{path}: image, resolution and origin: [x, y, theta] must stand in it")
    return path.parent / name, resolution_m, Pose2(x_m, y_m, theta_rad), dark, negate
