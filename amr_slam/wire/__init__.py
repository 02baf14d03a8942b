"""What goes over the network: messages, commands, keys, and the session's settings.

JSON in UTF-8, SI units, radians, finite numbers only. Each message carries the schema version
``v``; fields may be added within a version, so readers ignore those they do not know. What comes
from the network is bounded in size before it is parsed.

Needs pydantic and the standard library only: controllers import it without the robot's libraries.
"""

from amr_slam.wire.commands import (
    COMMANDS,
    Command,
    CommandReply,
    LoadMap,
    Relocalize,
    ResumePose,
    SaveMap,
    SaveRecording,
    SetPose,
    StartMapping,
    command_of,
)
from amr_slam.wire.map_changes import MAX_CHANGES, ChangePart, MapChanges
from amr_slam.wire.messages import (
    MAX_CANDIDATES,
    MAX_SCAN_POINTS,
    MAX_SLIPS,
    UNKNOWN,
    CalibrationPart,
    CandidatePart,
    ChangesPart,
    EpochDelta,
    HealthPart,
    MapImage,
    MapPart,
    OdomPose,
    PoseMessage,
    ScanMessage,
    SlipPart,
    StatusMessage,
)
from amr_slam.wire.schemas import json_schemas
from amr_slam.wire.settings import DEFAULT_ENDPOINT, Endpoint, ZenohSettings
from amr_slam.wire.shadow import MAX_SHADOW_ZONES, ShadowPart, ShadowZone
from amr_slam.wire.topics import Topic, command_key, robot_key, robot_of
from amr_slam.wire.values import (
    MAX_COMMAND_BYTES,
    MAX_MAP_BYTES,
    MAX_MESSAGE_BYTES,
    SCHEMA_VERSION,
    WireError,
)

__all__ = [
    "COMMANDS",
    "DEFAULT_ENDPOINT",
    "MAX_CANDIDATES",
    "MAX_CHANGES",
    "MAX_COMMAND_BYTES",
    "MAX_MAP_BYTES",
    "MAX_MESSAGE_BYTES",
    "MAX_SCAN_POINTS",
    "MAX_SHADOW_ZONES",
    "MAX_SLIPS",
    "SCHEMA_VERSION",
    "UNKNOWN",
    "CalibrationPart",
    "CandidatePart",
    "ChangePart",
    "ChangesPart",
    "Command",
    "CommandReply",
    "Endpoint",
    "EpochDelta",
    "HealthPart",
    "LoadMap",
    "MapChanges",
    "MapImage",
    "MapPart",
    "OdomPose",
    "PoseMessage",
    "Relocalize",
    "ResumePose",
    "SaveMap",
    "SaveRecording",
    "ScanMessage",
    "SetPose",
    "ShadowPart",
    "ShadowZone",
    "SlipPart",
    "StartMapping",
    "StatusMessage",
    "Topic",
    "WireError",
    "ZenohSettings",
    "command_key",
    "command_of",
    "json_schemas",
    "robot_key",
    "robot_of",
]
