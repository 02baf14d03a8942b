"""The further forms of messages that the configuration switches on."""

from __future__ import annotations

import os

from amr_slam.config import Config
from amr_slam.encodings import Encoder, vda5050
from amr_slam.encodings.ros2 import Ros2Encoder


def encoders(config: Config) -> list[Encoder]:
    """None unless it says so."""
    found: list[Encoder] = []
    if config.ros2.is_on:
        found.append(Ros2Encoder(config.ros2, config.robot.name, os.urandom(16)))
    found += vda5050.encoders(
        config.vda5050,
        prefix=config.zenoh.prefix,
        robot=config.robot.name,
        pose_hz=config.service.publish_hz,
    )
    return found
