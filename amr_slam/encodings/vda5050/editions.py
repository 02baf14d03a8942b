"""The versions of the standard: they say the same thing under different names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from amr_slam.encodings.vda5050.settings import Version

VISUALIZATION: Final = "visualization"
ACTIONS: Final = "instantActions"
STATE: Final = "state"


@dataclass(frozen=True, slots=True, kw_only=True)
class Edition:
    """What one version calls things; facts from its JSON schemas and tables."""

    version: str
    """In the header."""
    major: str
    """In the topics."""
    position: str
    localized: str
    """In the position: whether it can be trusted."""
    described_in_position: bool
    """Whether the position has a field for the map's description, too."""
    map_text: str
    refers_to_state: bool
    """Whether ``visualization`` names the state message that it belongs to."""
    not_localized: str
    """Type of the error. 2.1 leaves types to vendors."""
    set_pose: str
    """Type of the instant action."""
    action_states: str
    """Where ``state`` keeps the states of instant actions."""
    action_result: str


EDITIONS: Final[Mapping[Version, Edition]] = MappingProxyType(
    {
        "2.1": Edition(
            version="2.1.0",
            major="v2",
            position="agvPosition",
            localized="positionInitialized",
            described_in_position=True,
            map_text="mapDescription",
            refers_to_state=False,
            not_localized="localizationError",
            set_pose="initPosition",
            action_states="actionStates",
            action_result="resultDescription",
        ),
        "3.0": Edition(
            version="3.0.0",
            major="v3",
            position="mobileRobotPosition",
            localized="localized",
            described_in_position=False,
            map_text="mapDescriptor",
            refers_to_state=True,
            not_localized="LOCALIZATION_ERROR",
            set_pose="initializePosition",
            action_states="instantActionStates",
            action_result="actionResult",
        ),
    }
)
