"""The one look of all pictures: colours, lines, marks, grids, scale bars, files.

Colours are those of Okabe and Ito, told apart with any colour vision; lines and marks differ too,
so that nothing is said by colour alone. Every axis names its unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from amr_slam.geometry import Array

BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#CC79A7"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
INK: Final = "#000000"
GREY: Final = "#999999"
"""For what is only there to compare with."""
FLOOR: Final = "#E6EEF5"

TITLE_PT: Final = 11
LEGEND_PT: Final = 9
_LABEL_PT, _TICK_PT = 10, 9
_LEAST_MARK_PT: Final = 4.0
_FINE, _COARSE = "#EEEEEE", "#CCCCCC"
_DOTS_PER_INCH: Final = 110
# Grid lines of maps by the long side: (up to m, faint lines every m, strong lines every m).
_GRIDS: Final = ((40.0, 1.0, 5.0), (200.0, 5.0, 25.0), (float("inf"), 25.0, 100.0))

Corner = Literal["best", "upper left", "lower left", "lower right"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How one of several things is drawn, wherever it is drawn."""

    colour: str
    line: str
    marker: str
    """Filled, as matplotlib names it."""


# Of lengths that have no common divisor: no two of 252 things look alike.
_COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, INK)
_LINES: Final = ("-", "--", "-.", ":")
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*", "h")


def look(number: int) -> Look:
    """Of the ``number``-th thing, from 0."""
    return Look(
        colour=_COLOURS[number % len(_COLOURS)],
        line=_LINES[number % len(_LINES)],
        marker=_MARKERS[number % len(_MARKERS)],
    )


def sheet(width_in: float, height_in: float) -> Figure:
    """An empty picture for charts; what is put on it finds its own room."""
    return Figure(figsize=(width_in, height_in), dpi=_DOTS_PER_INCH, layout="constrained")


def chart(
    axes: Axes, *, x: str, y: str, title: str | None = None, legend: Corner | None = None
) -> None:
    """Labels with their units, a faint grid below everything, and a legend at ``legend`` (None:
    there is none). To be called when all is drawn."""
    axes.set_xlabel(x, fontsize=_LABEL_PT)
    axes.set_ylabel(y, fontsize=_LABEL_PT)
    axes.tick_params(labelsize=_TICK_PT)
    axes.grid(visible=True, color=_COARSE, linewidth=0.6)
    axes.set_axisbelow(True)
    if title is not None:
        axes.set_title(title, loc="left", fontsize=TITLE_PT)
    if legend is not None:
        axes.legend(loc=legend, fontsize=LEGEND_PT, framealpha=0.85)


def ground(axes: Axes, low: Array, high: Array) -> None:
    """Floor from corner ``low`` (2,) to ``high`` (2,), in m: grid, labels, limits, scale bar."""
    fine_m, coarse_m = steps_of(float((high - low).max()))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(coarse_m))
        axis.set_minor_locator(MultipleLocator(fine_m))
    axes.grid(which="minor", color=_FINE, linewidth=0.5)
    axes.grid(which="major", color=_COARSE, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.tick_params(labelsize=_TICK_PT)
    axes.set_xlabel(f"x in m (grid {fine_m:g} m / {coarse_m:g} m)", fontsize=_LABEL_PT)
    axes.set_ylabel("y in m", fontsize=_LABEL_PT)
    scale_bar(axes, low, high)


def steps_of(long_m: float) -> tuple[float, float]:
    """Of the faint and the strong lines in m, on a map whose longer side is ``long_m``."""
    return next((f, c) for up_to, f, c in _GRIDS if long_m <= up_to)


def scale_bar(axes: Axes, low: Array, high: Array) -> None:
    """The longest of 1, 2, 5, 10, ... m within a fifth of the width, at the lower left."""
    width_m = float(high[0] - low[0])
    lengths = np.outer(10.0 ** np.arange(-1, 4), (1.0, 2.0, 5.0)).ravel()
    length_m = float(lengths[lengths <= 0.2 * width_m].max(initial=0.1))
    x, y = low + 0.02 * float((high - low).max())
    axes.plot([x, x + length_m], [y, y], color=INK, linewidth=3.0, zorder=4.0)
    axes.annotate(
        f"{length_m:g} m", (x + 0.5 * length_m, y), xytext=(0.0, 4.0), textcoords="offset points",
        ha="center", va="bottom", fontsize=LEGEND_PT, zorder=4.0,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.0},
    )  # fmt: skip


def legend_above(axes: Axes) -> None:
    """The legend in the title's line, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    legend = axes.legend(
        handles,
        labels,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=max(len(labels), 1),
        frameon=False,
        fontsize=LEGEND_PT,
    )
    _show_small_marks(legend)


def legend_below(figure: Figure) -> None:
    """One legend for all charts of a picture, of what the last of them shows, at its foot."""
    handles, labels = figure.axes[-1].get_legend_handles_labels()
    legend = figure.legend(
        handles, labels, loc="lower center", ncols=len(labels), frameon=False, fontsize=LEGEND_PT,
        markerscale=1.6,
    )  # fmt: skip
    _show_small_marks(legend)


def _show_small_marks(legend: Legend) -> None:
    """Dots that only make a wall in their hundreds are too small to be seen alone."""
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D) and handle.get_markersize() < _LEAST_MARK_PT:
            handle.set_markersize(_LEAST_MARK_PT)


def save(figure: Figure, out: Path) -> None:
    """As PNG or SVG, without dates, versions and random names in the file.

    Raises ValueError for another ending, OSError where the file cannot be written.
    """
    metadata: dict[str, Any] = {".png": {"Software": None}, ".svg": {"Date": None}}
    if out.suffix not in metadata:
        raise ValueError(f"{out}: pictures end in .png or .svg")
    with mpl.rc_context({"svg.hashsalt": "amr-slam"}):
        figure.savefig(out, metadata=metadata[out.suffix])
