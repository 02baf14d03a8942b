"""All that is drawn: one style, for maps, studies, calibrations and alignments.

:mod:`style` has colours, grids, scale bars and files; :mod:`maps` draws maps and paths on it,
:mod:`pages` the layers of a web page.
"""

from amr_slam.pictures.maps import Georeference, draw_alignment, draw_changes, draw_map
from amr_slam.pictures.pages import Layer, Sheet
from amr_slam.pictures.panels import MapPanel, map_panels

__all__ = [
    "Georeference",
    "Layer",
    "MapPanel",
    "Sheet",
    "draw_alignment",
    "draw_changes",
    "draw_map",
    "map_panels",
]
