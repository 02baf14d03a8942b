"""What a robot answers on Zenoh beside its newest messages: commands, and its map.

Queries come in on zenoh's threads, are checked there, and wait for nobody: one thread a desk hands
them to the loop, waits for what becomes of them, and answers, as an answer may have to wait for a
slow network.
"""

from amr_slam.serving.asked import (
    Asked,
    ChangesWanted,
    ImageWanted,
    MapFile,
    MapWanted,
    NotDone,
    Picture,
    Put,
)
from amr_slam.serving.commands import CommandDesk
from amr_slam.serving.desk import Desk
from amr_slam.serving.inlets import InletDesk
from amr_slam.serving.maps import MapDesk
from amr_slam.serving.scans import thinned
from amr_slam.serving.telling import MapTeller

__all__ = [
    "Asked",
    "ChangesWanted",
    "CommandDesk",
    "Desk",
    "ImageWanted",
    "InletDesk",
    "MapDesk",
    "MapFile",
    "MapTeller",
    "MapWanted",
    "NotDone",
    "Picture",
    "Put",
    "thinned",
]
