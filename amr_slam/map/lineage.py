"""Which maps share a frame: versions of one map do, two maps of one hall do not."""

from __future__ import annotations

import hashlib

import numpy as np

from amr_slam.map.pointmap import PointMap
from amr_slam.map.provenance import to_header


def frame_of(known: PointMap) -> str:
    """The same for all versions of a map that have the same frame, in hexadecimal; empty for a map
    without scans, of which nobody knows.

    A map's first scan founds its frame and stays where it is, whatever joins the map later; moving
    the map into another frame moves it.
    """
    if not known.path:
        return ""
    stamp_ns, pose = known.path[0]
    told = f"{stamp_ns} {to_header(known.reframings)}".encode()
    return hashlib.sha256(np.asarray(pose.as_array(), dtype="<f8").tobytes() + told).hexdigest()
