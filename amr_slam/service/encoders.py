"""The further forms of messages that the configuration switches on."""

from __future__ import annotations

import os

from amr_slam.config import Config
from amr_slam.encodings import Encoder
from amr_slam.encodings.ros2 import Ros2Encoder


def encoders(config: Config) -> list[Encoder]:
    """None unless it says so."""
    found: list[Encoder] = []
    if config.ros2.is_on:
        found.append(Ros2Encoder(config.ros2, config.robot.name, os.urandom(16)))
    return found
