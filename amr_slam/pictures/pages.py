"""A map as layers for web pages: pictures for what has an area, lines and letters for the rest.

A page shows them on white and on black, on paper and enlarged; so layers have no background, and
the page's style sheet says what colour the lines are (walls are black here, inverted there).
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from amr_slam.geometry import Array
from amr_slam.map import PointMap
from amr_slam.map.export import FREE, OCCUPIED, occupancy_image
from amr_slam.pictures.maps import limits
from amr_slam.pictures.style import steps_of

_WIDTH: Final = 960.0
_MOST_HEIGHT: Final = 1080.0
_MOST_DOTS: Final = 1600


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """A picture with transparent parts, and where it lies on the sheet."""

    uri: str
    """``data:`` with a PNG file."""
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A line of a grid, with its number in m."""

    at: float
    text: str
    strong: bool


class Sheet:
    """A map on a sheet of ``width`` by ``height`` units, y downwards."""

    def __init__(self, known: PointMap, points_m: Array) -> None:
        """With room for ``points_m`` (n, 2) as well. Raises MapError for a map too large."""
        self._known = known
        self._low, self._high = limits(known, [points_m])
        side = self._high - self._low
        self.per_m = float(min(_WIDTH / side[0], _MOST_HEIGHT / side[1]))
        self.width, self.height = (float(one) for one in side * self.per_m)

    def at(self, point_m: Array | Sequence[float]) -> tuple[float, float]:
        """Where a point (2,) of the map lies on the sheet."""
        x = (float(point_m[0]) - float(self._low[0])) * self.per_m
        y = (float(self._high[1]) - float(point_m[1])) * self.per_m
        return round(x, 1), round(y, 1)

    def trail(self, points_m: Array) -> str:
        """Points (n, 2) as SVG writes them."""
        return " ".join(f"{x:g},{y:g}" for x, y in map(self.at, points_m))

    def grid(self, axis: int) -> list[Line]:
        """Lines across an axis, 0 for x and 1 for y."""
        low, high = float(self._low[axis]), float(self._high[axis])
        fine_m, coarse_m = steps_of(float((self._high - self._low).max()))
        lines = []
        for number in range(math.ceil(low / fine_m), math.floor(high / fine_m) + 1):
            value_m = number * fine_m
            point = self._low.copy()
            point[axis] = value_m
            ratio = value_m / coarse_m
            strong = abs(ratio - round(ratio)) < 1e-6
            lines.append(Line(at=self.at(point)[axis], text=f"{value_m:g}", strong=strong))
        return lines

    def bar_m(self) -> float:
        """Length of a scale bar: 1, 2 or 5 times a power of ten, up to a fifth of the width."""
        lengths = np.outer(10.0 ** np.arange(-1, 4), (1.0, 2.0, 5.0)).ravel()
        return float(lengths[lengths <= 0.2 * self.width / self.per_m].max(initial=0.1))

    def known(self) -> tuple[Layer, Layer]:
        """The floor that was seen, and the walls, both black."""
        dot_m = max(self._known.params.cell_m, self.width / self.per_m / _MOST_DOTS)
        image = occupancy_image(self._known, dot_m)
        corner = np.array([image.x_min_m, image.y_min_m])
        layers = []
        for grey in (FREE, OCCUPIED):
            colours = np.zeros((*image.pixels.shape, 4), dtype=np.uint8)
            colours[image.pixels == grey, 3] = 255
            layers.append(self._layer(colours, corner, image.resolution_m))
        return layers[0], layers[1]

    def heat(
        self, cells_m: Array, cell_m: float, classes: NDArray[np.intp], colours: Sequence[str]
    ) -> Layer:
        """Square cells (n, 2) by their middles, each in the colour (#rrggbb) of its class (n,)."""
        dot_m = max(cell_m, self.width / self.per_m / _MOST_DOTS)
        index = np.floor(cells_m / dot_m).astype(np.int64)
        low = index.min(axis=0)
        columns, rows = index.max(axis=0) - low + 1
        pixels = np.zeros((rows, columns, 4), dtype=np.uint8)
        palette = np.array([[*bytes.fromhex(colour[1:]), 255] for colour in colours])
        # The worse class of those that share a dot is the later one.
        order = np.argsort(classes, kind="stable")
        column, row = (index - low)[order].T
        pixels[rows - 1 - row, column] = palette[classes[order]]
        return self._layer(pixels, low * dot_m, dot_m)

    def _layer(self, pixels: NDArray[np.uint8], corner_m: Array, dot_m: float) -> Layer:
        rows, columns = pixels.shape[:2]
        x, y = self.at(corner_m + np.array([0.0, rows * dot_m]))
        stream = io.BytesIO()
        Image.fromarray(pixels).quantize(32).save(stream, "png", optimize=True)
        text = base64.b64encode(stream.getvalue()).decode("ascii")
        return Layer(
            uri=f"data:image/png;base64,{text}",
            x=x, y=y, width=columns * dot_m * self.per_m, height=rows * dot_m * self.per_m,
        )  # fmt: skip
