"""What a pose is worth. Standard library only: also those know it who only read poses."""

from __future__ import annotations

import enum
from typing import Literal

Mode = Literal["mapping", "localization"]
"""Which of the two a robot does with its map."""


class State(enum.StrEnum):
    """What a published pose is worth (contracts: ``state``)."""

    STARTING = "starting"
    LOCALIZED = "localized"
    ODOMETRY_ONLY = "odometry_only"
    LOST = "lost"
    AMBIGUOUS = "ambiguous"
    MAPPING = "mapping"
