"""The keys on which a robot speaks and is asked: ``<prefix>/<robot>/<topic>``."""

from __future__ import annotations

import enum


class Topic(enum.StrEnum):
    """Last part of a robot's key."""

    POSE = "pose"
    """Published; answers ``get`` with the latest."""
    FLEET_POSE = "fleet_pose"
    """Every n-th of these poses, for those who follow many robots; answers ``get``, too."""
    STATUS = "status"
    """Published; answers ``get`` with the latest."""
    SCAN = "scan"
    """Published; answers ``get`` with the latest, thinned to ``?points=N`` on request."""
    ALIVE = "alive"
    """Liveliness token."""
    MAP = "map"
    """Answers ``get`` with the active map as .amrmap."""
    MAP_IMAGE = "map/image"
    """Answers ``get`` with a PNG; its georeference (MapImage) is the reply's attachment."""
    MAP_CHANGES = "map/changes"
    """Answers ``get`` with what has changed in the place since (MapChanges)."""


def robot_key(prefix: str, robot: str, leaf: str) -> str:
    """The key of one of a robot's topics; ``*`` as robot: the key expression of all robots'."""
    return f"{prefix}/{robot}/{leaf}"


def command_key(prefix: str, robot: str, command: str) -> str:
    """Where a robot is told to do something."""
    return robot_key(prefix, robot, f"cmd/{command}")


def robot_of(key: str) -> str:
    """The robot's name in a key made by :func:`robot_key` of a topic of one part."""
    return key.rsplit("/", 2)[-2]
