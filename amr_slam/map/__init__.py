"""The point-cloud map: what was seen where, how it grows, and its file."""

from amr_slam.map.file import MapError, load_map, save_map
from amr_slam.map.layers import Edit, Layer, LayerError, LayerKind, Layers
from amr_slam.map.moving import moved
from amr_slam.map.params import MapParams
from amr_slam.map.pointmap import PointMap
from amr_slam.map.provenance import Imported, Merged, Reframing
from amr_slam.map.versions import LoadedMap, load_newest, roll_back

__all__ = [
    "Edit",
    "Imported",
    "Layer",
    "LayerError",
    "LayerKind",
    "Layers",
    "LoadedMap",
    "MapError",
    "MapParams",
    "Merged",
    "PointMap",
    "Reframing",
    "load_map",
    "load_newest",
    "moved",
    "roll_back",
    "save_map",
]
