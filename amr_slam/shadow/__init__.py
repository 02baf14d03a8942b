"""Shadow mode: a camera system's poses beside the robot's own, compared and never used.

Nothing here can reach the estimate: what the robot publishes comes in, numbers for people go out.
"""

from amr_slam.shadow.messages import CameraPose, CameraPoseError, parse
from amr_slam.shadow.settings import FrameSettings, ShadowSettings
from amr_slam.shadow.watcher import Shadow

__all__ = [
    "CameraPose",
    "CameraPoseError",
    "FrameSettings",
    "Shadow",
    "ShadowSettings",
    "parse",
]
