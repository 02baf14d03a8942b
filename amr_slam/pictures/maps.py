"""Pictures of maps, of paths in them, and of what brought a map into its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from amr_slam.geometry import Array
from amr_slam.living import MapDiff
from amr_slam.map import LayerKind, Layers, PointMap
from amr_slam.map.export import FREE, occupancy_image
from amr_slam.pictures import style
from amr_slam.pictures.style import BLUE, FLOOR, GREEN, INK, PURPLE, VERMILION
from amr_slam.recording import Trajectory

_DOTS_PER_INCH: Final = 150
_LONG_SIDE_IN: Final = 10.0
# Left, right, bottom, top: room for axis labels and the title's line.
_MARGINS_IN: Final = (0.8, 0.25, 0.65, 0.5)
_LAYERS: Final = {
    LayerKind.ERASE: ("erased", VERMILION, "xx"),
    LayerKind.WALL: ("drawn walls", GREEN, ""),
    LayerKind.ZONE: ("no-localize zones", PURPLE, "//"),
}
_SHORT_SIDE: Final = 0.4  # of the long one, at least: titles and scale bar need width


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
    draw_layers(canvas.axes, known.layers)
    for number, (label, points) in enumerate(lines):
        draw_path(canvas.axes, points, label, style.look(number))
    canvas.finish(out)
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
    axes = canvas.axes
    for points, label, colour, marker, size in (
        (plan_m, "floor plan", VERMILION, "s", 1.5),
        (strangers_m, "left out", PURPLE, "x", 4.0),
    ):
        if len(points):
            axes.plot(*points.T, marker, color=colour, markersize=size, label=label, zorder=2.5)
    if len(starts_m):
        axes.plot(*starts_m.T, ".", color=BLUE, markersize=2.0, label="pairs", zorder=2.8)
        _draw_arrows(axes, starts_m, offsets_m)
    canvas.finish(out)
    return canvas.place


def draw_changes(known: PointMap, diff: MapDiff, out: Path, title: str) -> Georeference:
    """A map with what has changed in it: squares what is new, crosses what is gone, each thing with
    its number. Raises as :func:`draw_map`."""
    canvas = _canvas(known, [change.cells_m for change in diff.changes], title)
    for kind, colour, marker in (("new", VERMILION, "s"), ("gone", BLUE, "x")):
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
    canvas.finish(out)
    return canvas.place


def _draw_arrows(axes: Axes, starts_m: Array, offsets_m: Array) -> None:
    """Magnified so that a large one takes a thirtieth of the picture; a key says by how much."""
    low, high = axes.get_xlim()
    most_m = max(float(np.percentile(np.hypot(*offsets_m.T), 95.0)), 1e-4)
    steps = np.outer(10.0 ** np.arange(-1, 5), (1.0, 2.0, 5.0)).ravel()
    magnified = float(steps[steps <= max((high - low) / 30.0 / most_m, 0.1)].max())
    drawn = axes.quiver(
        *starts_m.T, *offsets_m.T, angles="xy", scale_units="xy", scale=1.0 / magnified,
        color=VERMILION, width=0.0012, zorder=3.0,
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

    def finish(self, out: Path) -> None:
        """With the labels of what was drawn into the file."""
        style.legend_above(self.axes)
        style.save(self.figure, out)


def _canvas(known: PointMap, points_m: Sequence[Array], title: str) -> _Canvas:
    """The map within limits that ``points_m``, arrays (n, 2), lie in."""
    low, high = limits(known, points_m)
    left, right, bottom, top = _MARGINS_IN
    inches_per_m = _LONG_SIDE_IN / float((high - low).max())
    plot_in = (high - low) * inches_per_m
    size_in = plot_in + np.array([left + right, bottom + top])
    pixels = np.round(size_in * _DOTS_PER_INCH)
    figure = Figure(figsize=tuple(pixels / _DOTS_PER_INCH), dpi=_DOTS_PER_INCH)
    axes = figure.add_axes(
        (left / size_in[0], bottom / size_in[1], plot_in[0] / size_in[0], plot_in[1] / size_in[1])
    )
    style.ground(axes, low, high)
    draw_known(axes, known, inches_per_m)
    axes.set_title(title, loc="left", fontsize=style.TITLE_PT)
    px_per_m = inches_per_m * _DOTS_PER_INCH
    place = Georeference(
        width_px=int(pixels[0]),
        height_px=int(pixels[1]),
        metres_per_px=1.0 / px_per_m,
        column_of_x0_px=float(left * _DOTS_PER_INCH - low[0] * px_per_m),
        row_of_y0_px=float(pixels[1] - bottom * _DOTS_PER_INCH + low[1] * px_per_m),
    )
    return _Canvas(figure=figure, axes=axes, place=place)


def limits(known: PointMap, paths: Sequence[Array]) -> tuple[Array, Array]:
    """Lower left and upper right corner (2,) of what is drawn, in m, with a border."""
    x_min, y_min, x_max, y_max = known.bounds()
    everything = np.concatenate([np.array([[x_min, y_min], [x_max, y_max]]), *paths])
    low, high = everything.min(axis=0) - 0.5, everything.max(axis=0) + 0.5
    side = np.maximum(high - low, _SHORT_SIDE * float((high - low).max()))
    middle = 0.5 * (low + high)
    return middle - 0.5 * side, middle + 0.5 * side


def draw_known(
    axes: Axes,
    known: PointMap,
    inches_per_m: float,
    *,
    colour: str = INK,
    dots_per_inch: int = _DOTS_PER_INCH,
) -> None:
    """Walls in ``colour`` and the floor that was seen, on axes of this scale."""
    # No finer than the picture itself: memory goes with the picture, not with the hall.
    dot_m = 1.0 / (inches_per_m * dots_per_inch)
    image = occupancy_image(known, max(known.spacing_m, dot_m))
    rows, columns = image.pixels.shape
    right = image.x_min_m + columns * image.resolution_m
    top = image.y_min_m + rows * image.resolution_m
    # Half transparent: the grid shows through the floor.
    axes.imshow(
        np.ma.masked_where(image.pixels != FREE, image.pixels),
        cmap=ListedColormap([FLOOR]),
        extent=(image.x_min_m, right, image.y_min_m, top),
        interpolation="nearest",
        alpha=0.7,
        aspect="auto",
        zorder=0.4,
    )
    walls = known.surfaces().points_m
    # As large as the cell that a point stands for, but never too small to be seen.
    points = max(known.spacing_m * inches_per_m * 72.0, 1.0)
    axes.plot(
        *walls.T, linestyle="", marker="s", markersize=points, markeredgewidth=0.0, color=colour,
        rasterized=True, zorder=2.0, label="walls",
    )  # fmt: skip


def draw_layers(axes: Axes, layers: Layers) -> None:
    """Erased areas, drawn walls and zones without landmarks, each with its name."""
    for kind, (label, colour, hatch) in _LAYERS.items():
        drawn = [one for one in layers.active if one.kind is kind]
        for i, one in enumerate(drawn):
            told = label if i == 0 else None
            if kind is LayerKind.WALL:
                axes.plot(*one.corners_m.T, color=colour, linewidth=2.0, label=told, zorder=2.2)
            else:
                axes.fill(
                    *one.corners_m.T, facecolor="none", edgecolor=colour, linewidth=1.2,
                    hatch=hatch, label=told, zorder=2.2,
                )  # fmt: skip
            axes.annotate(
                one.name, one.corners_m[0], xytext=(3.0, 3.0), textcoords="offset points",
                color=colour, fontsize=style.LEGEND_PT, zorder=4.0,
            )  # fmt: skip


def draw_path(axes: Axes, points: Array, label: str, drawn_as: style.Look) -> None:
    """Points (n, 2) in m as a line that begins at a dot and ends at a cross."""
    colour = drawn_as.colour
    axes.plot(
        *points.T, color=colour, linestyle=drawn_as.line, linewidth=1.3, label=label, zorder=3.0
    )
    for end, marker in ((points[:1], "o"), (points[-1:], "X")):
        axes.plot(*end.T, marker, color=colour, markersize=6.0, zorder=3.1)
