"""Maps that live: changes watched beside a map, listed, and accepted as a new version of it."""

from amr_slam.living.accepting import Accepted, accept, eligible
from amr_slam.living.change import MapChange, MapDiff
from amr_slam.living.comparing import OtherFrameError, compare_maps
from amr_slam.living.file import (
    ChangesError,
    changes_path,
    load_changes,
    resume_watching,
    save_changes,
)
from amr_slam.living.keeping import ChangeKeeper
from amr_slam.living.params import AcceptPolicy, WatchParams
from amr_slam.living.watcher import ChangeCounts, Watcher

__all__ = [
    "AcceptPolicy",
    "Accepted",
    "ChangeCounts",
    "ChangeKeeper",
    "ChangesError",
    "MapChange",
    "MapDiff",
    "OtherFrameError",
    "WatchParams",
    "Watcher",
    "accept",
    "changes_path",
    "compare_maps",
    "eligible",
    "load_changes",
    "resume_watching",
    "save_changes",
]
