"""Maps side by side at one scale: how the paper shows its own, and what studies compare."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from amr_slam.geometry import Array
from amr_slam.map import PointMap
from amr_slam.pictures import style
from amr_slam.pictures.maps import draw_known, limits
from amr_slam.pictures.style import BLUE, GREEN, VERMILION

_DOTS_PER_INCH: Final = 110
# Left of each, right of the last, below (with the legend) and above: room for labels and titles.
_LEFT_IN, _RIGHT_IN, _BELOW_IN, _ABOVE_IN = 0.6, 0.15, 0.85, 0.4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapPanel:
    """One of the maps."""

    title: str
    known: PointMap
    path_m: Array
    """(n, 2) positions at the scans, in the map's frame."""
    scan_m: Array | None = None
    """(k, 2) points of a scan as it was registered, in the map's frame."""


def map_panels(panels: Sequence[MapPanel], width_in: float) -> Figure:
    """Walls, poses at the scans and, where there is one, the scan of each; one scale for all.

    In the paper's colours as far as all eyes tell them apart: its red is a vermilion here.
    """
    corners = np.array([limits(panel.known, [panel.path_m, _scan(panel)]) for panel in panels])
    low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
    each_in = (width_in - _RIGHT_IN) / len(panels) - _LEFT_IN
    inches_per_m = each_in / float(high[0] - low[0])
    tall_in = float(high[1] - low[1]) * inches_per_m
    size_in = np.array([width_in, tall_in + _BELOW_IN + _ABOVE_IN])
    figure = Figure(figsize=(size_in[0], size_in[1]), dpi=_DOTS_PER_INCH)
    for number, panel in enumerate(panels):
        left_in = _LEFT_IN + number * (_LEFT_IN + each_in)
        axes = figure.add_axes(
            (left_in / size_in[0], _BELOW_IN / size_in[1], each_in / size_in[0],
             tall_in / size_in[1])
        )  # fmt: skip
        style.ground(axes, low, high)
        draw_known(axes, panel.known, inches_per_m, colour=BLUE, dots_per_inch=_DOTS_PER_INCH)
        axes.plot(*panel.path_m.T, ".-", color=GREEN, markersize=4.0, linewidth=0.7, zorder=3.0,
                  label="poses of the scans")  # fmt: skip
        if panel.scan_m is not None:
            axes.plot(*panel.scan_m.T, ".", color=VERMILION, markersize=2.5, zorder=3.5,
                      label="the scan, as registered")  # fmt: skip
            axes.plot(*panel.path_m[-1:].T, "X", color=VERMILION, markersize=7.0, zorder=3.6,
                      label="the robot")  # fmt: skip
        axes.set_title(panel.title, loc="left", fontsize=style.TITLE_PT)
        if number:
            axes.set_ylabel("")
    style.legend_below(figure)
    return figure


def _scan(panel: MapPanel) -> Array:
    return np.empty((0, 2)) if panel.scan_m is None else panel.scan_m
