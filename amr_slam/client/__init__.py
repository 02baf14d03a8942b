"""For fleet controllers: poses, status and liveliness of robots, commands to them, their maps.

    async with Robot("amr7", endpoint="tcp/192.168.1.5:7447") as robot:
        async for pose in robot.poses():
            ...

:class:`Fleet` follows several robots on one session; :class:`FleetListener` is for programs with
threads. Needs zenoh and pydantic only.
"""

from amr_slam.client.asking import (
    AskingError,
    CommandRefusedError,
    ask_map,
    ask_map_changes,
    ask_map_image,
    call,
)
from amr_slam.client.listening import FleetListener, RobotView
from amr_slam.client.robots import Fleet, Robot, StalePoseError
from amr_slam.client.session import SessionError, close_session, open_client

__all__ = [
    "AskingError",
    "CommandRefusedError",
    "Fleet",
    "FleetListener",
    "Robot",
    "RobotView",
    "SessionError",
    "StalePoseError",
    "ask_map",
    "ask_map_changes",
    "ask_map_image",
    "call",
    "close_session",
    "open_client",
]
