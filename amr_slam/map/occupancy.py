"""A picture of a map as cells: wall, floor, or unknown."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from amr_slam.geometry import Pose2
from amr_slam.map.described import Described
from amr_slam.map.file import MapError

MAX_PIXELS: Final = 40_000_000
"""500 x 200 m in cells of 5 cm: what is made of them fits into a robot's memory."""
_FORMATS: Final = ("PPM", "PNG", "BMP", "JPEG", "TIFF")
_MOST_RAW: Final = 100
_UNKNOWN, _FREE = 205, 254


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OccupancyGrid:
    """Cells (rows, columns), the first row at the lower edge, the first column at the left."""

    occupied: NDArray[np.bool_]
    free: NDArray[np.bool_]
    resolution_m: float
    map_from_corner: Pose2
    """Pose of the lower left corner."""


def read_grid(described: Described) -> OccupancyGrid:
    """The picture, as a map server reads it. Raises MapError."""
    shade, opacity = _shades(described.image)
    low, high = described.free_thresh, described.occupied_thresh
    if low >= high:
        raise MapError(
            f"{described.image}: its YAML file says free_thresh {low:g}, occupied_thresh {high:g}: "
            "the first must be less"
        )
    known = np.ones(shade.shape, dtype=np.bool_)
    if described.mode == "trinary":
        known = ~_saved_as_unknown(shade)
    if described.mode == "trinary" and opacity is not None:
        shade = 0.75 * shade + 0.25 * opacity  # so do map servers: transparent is dark
    if described.mode == "scale" and opacity is not None:
        known = opacity >= 1.0
    occupancy = shade if described.negate else 1.0 - shade
    if described.mode == "raw":
        # The grey value is the occupancy in percent; beyond 100 it says unknown.
        percent = np.round(255.0 * shade)
        occupancy, known = percent / _MOST_RAW, percent <= _MOST_RAW
    # What lies between both thresholds is told by a number in the mode scale: it is no wall yet.
    return OccupancyGrid(
        occupied=(known & (occupancy > high))[::-1],
        free=(known & (occupancy < low))[::-1],
        resolution_m=described.resolution_m,
        map_from_corner=described.map_from_corner,
    )


def _saved_as_unknown(shade: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Map savers write 254 for floor and 205 for unknown, with thresholds by which the latter is
    floor, too (nav2's own default): what nobody has seen must be no place to look for a robot."""
    grey = np.round(255.0 * shade)
    return np.asarray((grey == _UNKNOWN) & np.any(grey == _FREE))


def _shades(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """(rows, columns) 0 black to 1 white, and 0 transparent to 1 opaque where there is such."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=_FORMATS) as picture:
                width, height = picture.size
                if width * height <= MAX_PIXELS:
                    return _grey(picture)
    except OSError as error:
        raise MapError(f"{path}: cannot be read as a picture: {error.strerror or error}") from error
    except Image.DecompressionBombError as error:
        raise MapError(f"{path}: more than {MAX_PIXELS} pixels: {error}") from error
    except (ValueError, SyntaxError, EOFError) as error:
        raise MapError(f"{path}: the picture is damaged: {error}") from error
    raise MapError(
        f"{path}: {width} x {height} pixels, more than {MAX_PIXELS}: cut it into parts, or make "
        "its cells larger"
    )


def _grey(picture: Image.Image) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    if picture.mode.startswith("I") or picture.mode == "F":
        return np.asarray(picture, dtype=np.float32) / np.float32(65535.0), None
    if not picture.has_transparency_data:
        return np.asarray(picture.convert("L"), dtype=np.float32) / np.float32(255.0), None
    grey, opacity = (
        np.asarray(band, dtype=np.float32) / np.float32(255.0)
        for band in picture.convert("LA").split()
    )
    return grey, opacity
