"""Pictures of maps and paths: the one place that draws.

Colours are those of Okabe and Ito, told apart with any colour vision; line styles differ too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from amr_slam.geometry import Array
from amr_slam.living import MapDiff
from amr_slam.map import PointMap
from amr_slam.map.export import FREE, occupancy_image
from amr_slam.recording import Trajectory

_LINES: Final = (
    ("#0072B2", "-"),
    ("#D55E00", "--"),
    ("#009E73", "-."),
    ("#CC79A7", ":"),
)
_FLOOR: Final = "#E6EEF5"
_DOTS_PER_INCH: Final = 150
_LONG_SIDE_IN: Final = 10.0
# Left, right, bottom, top: room for axis labels and the title's line.
_MARGINS_IN: Final = (0.8, 0.25, 0.65, 0.5)
_SHORT_SIDE: Final = 0.4  # of the long one, at least: titles and scale bar need width
# Grid lines by the long side: (up to m, faint lines every m, strong lines every m).
_GRIDS: Final = ((40.0, 1.0, 5.0), (200.0, 5.0, 25.0), (float("inf"), 25.0, 100.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Georeference:
    """Where a PNG picture lies in the map frame."""

    width_px: int
    height_px: int
    metres_per_px: float
    column_of_x0_px: float
    """Column of x = 0 m; columns grow with x."""
    row_of_y0_px: float
    """Row of y = 0 m; rows grow against y."""


def draw_map(
    known: PointMap,
    paths: Sequence[tuple[str, Trajectory | Array]],
    out: Path,
    title: str,
) -> Georeference:
    """Draw walls, seen floor and labelled paths, all in the map frame, into a PNG or SVG file.

    ``paths``: trajectories or (n, 2) positions in m. The same map and paths give the same bytes.
    Raises OSError, MapError for a map too large to draw, and ValueError for another file ending.
    """
    lines = [
        (label, path.poses[:, :2] if isinstance(path, Trajectory) else path)
        for label, path in paths
    ]
    canvas = _canvas(known, [points for _, points in lines], title)
    for (label, points), (colour, style) in zip(lines, cycle(_LINES), strict=False):
        _draw_path(canvas.axes, points, label, colour, style)
    canvas.finish(out, labels=len(lines))
    return canvas.place


def draw_alignment(
    known: PointMap,
    plan_m: Array,
    arrows: tuple[Array, Array],
    strangers_m: Array,
    out: Path,
    title: str,
) -> Georeference:
    """What brought a map into its frame: ``plan_m`` (n, 2) a floor plan's walls; ``arrows``: where
    the map has each point (k, 2) and how far off the site has it (k, 2), drawn many times as long;
    ``strangers_m`` (j, 2) points that were left out. All in the map's frame, any may be empty.

    Raises as :func:`draw_map`.
    """
    starts_m, offsets_m = arrows
    canvas = _canvas(known, [plan_m, starts_m], title)
    axes, labels = canvas.axes, 0
    for points, label, colour, marker, size in (
        (plan_m, "floor plan", _LINES[1][0], "s", 1.5),
        (strangers_m, "left out", _LINES[3][0], "x", 4.0),
    ):
        if len(points):
            axes.plot(*points.T, marker, color=colour, markersize=size, label=label, zorder=2.5)
            labels += 1
    if len(starts_m):
        axes.plot(*starts_m.T, ".", color=_LINES[0][0], markersize=2.0, label="pairs", zorder=2.8)
        _draw_arrows(axes, starts_m, offsets_m)
        labels += 1
    canvas.finish(out, labels=labels)
    return canvas.place


def draw_changes(known: PointMap, diff: MapDiff, out: Path, title: str) -> Georeference:
    """A map with what has changed in it: squares what is new, crosses what is gone, each thing with
    its number. Raises as :func:`draw_map`."""
    canvas = _canvas(known, [change.cells_m for change in diff.changes], title)
    labels = 0
    for kind, (colour, _), marker in (("new", _LINES[1], "s"), ("gone", _LINES[0], "x")):
        things = [change for change in diff.changes if change.kind == kind]
        if not things:
            continue
        cells = np.concatenate([change.cells_m for change in things])
        canvas.axes.plot(
            *cells.T, marker, color=colour, markersize=3.5, markeredgewidth=1.2,
            label=f"{kind} ({len(things)})", zorder=3.0,
        )  # fmt: skip
        for change in things:
            canvas.axes.annotate(
                str(change.number), change.centre_m, ha="center", va="center", fontsize=9,
                color=colour, fontweight="bold", zorder=4.0,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.8},
            )  # fmt: skip
        labels += 1
    canvas.finish(out, labels=labels)
    return canvas.place


def _draw_arrows(axes: Axes, starts_m: Array, offsets_m: Array) -> None:
    """Magnified so that a large one takes a thirtieth of the picture; a key says by how much."""
    low, high = axes.get_xlim()
    most_m = max(float(np.percentile(np.hypot(*offsets_m.T), 95.0)), 1e-4)
    steps = np.outer(10.0 ** np.arange(-1, 5), (1.0, 2.0, 5.0)).ravel()
    magnified = float(steps[steps <= max((high - low) / 30.0 / most_m, 0.1)].max())
    drawn = axes.quiver(
        *starts_m.T, *offsets_m.T, angles="xy", scale_units="xy", scale=1.0 / magnified,
        color=_LINES[1][0], width=0.0012, zorder=3.0,
    )  # fmt: skip
    lengths = steps / 1000.0
    key_m = float(lengths[lengths * magnified <= 0.08 * (high - low)].max(initial=1e-4))
    axes.quiverkey(
        drawn, 0.9, 0.02, key_m, f"residual {100.0 * key_m:g} cm (x {magnified:g})",
        labelpos="W", coordinates="axes", zorder=4.0,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Canvas:
    """A map, drawn, on which more is to be drawn."""

    figure: Figure
    axes: Axes
    place: Georeference

    def finish(self, out: Path, *, labels: int) -> None:
        """With the labels of what was drawn, if there are any, into the file."""
        if labels:
            self.axes.legend(
                loc="lower right",
                bbox_to_anchor=(1.0, 1.0),
                ncols=labels,
                frameon=False,
                fontsize=9,
            )
        _save(self.figure, out)


def _canvas(known: PointMap, points_m: Sequence[Array], title: str) -> _Canvas:
    """The map within limits that ``points_m``, arrays (n, 2), lie in."""
    low, high = _limits(known, points_m)
    left, right, bottom, top = _MARGINS_IN
    inches_per_m = _LONG_SIDE_IN / float((high - low).max())
    plot_in = (high - low) * inches_per_m
    size_in = plot_in + np.array([left + right, bottom + top])
    pixels = np.round(size_in * _DOTS_PER_INCH)
    figure = Figure(figsize=tuple(pixels / _DOTS_PER_INCH), dpi=_DOTS_PER_INCH)
    axes = figure.add_axes(
        (left / size_in[0], bottom / size_in[1], plot_in[0] / size_in[0], plot_in[1] / size_in[1])
    )
    _draw_grid(axes, low, high)
    _draw_known(axes, known, inches_per_m)
    _draw_scale_bar(axes, low, high)
    axes.set_title(title, loc="left", fontsize=11)
    px_per_m = inches_per_m * _DOTS_PER_INCH
    place = Georeference(
        width_px=int(pixels[0]),
        height_px=int(pixels[1]),
        metres_per_px=1.0 / px_per_m,
        column_of_x0_px=float(left * _DOTS_PER_INCH - low[0] * px_per_m),
        row_of_y0_px=float(pixels[1] - bottom * _DOTS_PER_INCH + low[1] * px_per_m),
    )
    return _Canvas(figure=figure, axes=axes, place=place)


def _limits(known: PointMap, paths: Sequence[Array]) -> tuple[Array, Array]:
    """Lower left and upper right corner (2,) of what is drawn, in m, with a border."""
    x_min, y_min, x_max, y_max = known.bounds()
    everything = np.concatenate([np.array([[x_min, y_min], [x_max, y_max]]), *paths])
    low, high = everything.min(axis=0) - 0.5, everything.max(axis=0) + 0.5
    side = np.maximum(high - low, _SHORT_SIDE * float((high - low).max()))
    middle = 0.5 * (low + high)
    return middle - 0.5 * side, middle + 0.5 * side


def _draw_grid(axes: Axes, low: Array, high: Array) -> None:
    long_m = float((high - low).max())
    fine_m, coarse_m = next((f, c) for up_to, f, c in _GRIDS if long_m <= up_to)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(coarse_m))
        axis.set_minor_locator(MultipleLocator(fine_m))
    axes.grid(which="minor", color="#EEEEEE", linewidth=0.5)
    axes.grid(which="major", color="#CCCCCC", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel(f"x in m (grid {fine_m:g} m / {coarse_m:g} m)")
    axes.set_ylabel("y in m")


def _draw_known(axes: Axes, known: PointMap, inches_per_m: float) -> None:
    # No finer than the picture itself: memory goes with the picture, not with the hall.
    dot_m = 1.0 / (inches_per_m * _DOTS_PER_INCH)
    image = occupancy_image(known, max(known.params.cell_m, dot_m))
    rows, columns = image.pixels.shape
    right = image.x_min_m + columns * image.resolution_m
    top = image.y_min_m + rows * image.resolution_m
    # Half transparent: the grid shows through the floor.
    axes.imshow(
        np.ma.masked_where(image.pixels != FREE, image.pixels),
        cmap=ListedColormap([_FLOOR]),
        extent=(image.x_min_m, right, image.y_min_m, top),
        interpolation="nearest",
        alpha=0.7,
        aspect="auto",
        zorder=0.4,
    )
    walls = known.target().points_m
    # As large as the cell that a point stands for, but never too small to be seen.
    points = max(known.params.cell_m * inches_per_m * 72.0, 1.0)
    axes.plot(
        *walls.T, linestyle="", marker="s", markersize=points, markeredgewidth=0.0, color="black",
        rasterized=True, zorder=2.0,
    )  # fmt: skip


def _draw_path(axes: Axes, points: Array, label: str, colour: str, style: str) -> None:
    axes.plot(*points.T, color=colour, linestyle=style, linewidth=1.3, label=label, zorder=3.0)
    for end, marker in ((points[:1], "o"), (points[-1:], "X")):
        axes.plot(*end.T, marker, color=colour, markersize=6.0, zorder=3.1)


def _draw_scale_bar(axes: Axes, low: Array, high: Array) -> None:
    """The longest of 1, 2, 5, 10, ... m within a fifth of the width, at the lower left."""
    width_m = float(high[0] - low[0])
    lengths = np.outer(10.0 ** np.arange(-1, 4), (1.0, 2.0, 5.0)).ravel()
    length_m = float(lengths[lengths <= 0.2 * width_m].max(initial=0.1))
    x, y = low + 0.02 * float((high - low).max())
    axes.plot([x, x + length_m], [y, y], color="black", linewidth=3.0, zorder=4.0)
    axes.annotate(
        f"{length_m:g} m", (x + 0.5 * length_m, y), xytext=(0.0, 4.0), textcoords="offset points",
        ha="center", va="bottom", fontsize=9, zorder=4.0,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.0},
    )  # fmt: skip


def _save(figure: Figure, out: Path) -> None:
    """Without dates, versions and random names in the file."""
    metadata: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}}
    if out.suffix not in metadata:
        raise ValueError(f"{out}: pictures end in .png or .svg")
    with mpl.rc_context({"svg.hashsalt": "amr-slam"}):
        figure.savefig(out, metadata=metadata[out.suffix])
