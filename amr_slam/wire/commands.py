"""What a robot can be told to do: arguments, checked before anything is done, and the reply.

A command is a ``get`` on ``<prefix>/<robot>/cmd/<command>`` with the arguments as payload; the
reply is a :class:`CommandReply`. Unlike messages, arguments have no room for unknown fields: a
mistyped one must not be taken for a wish.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, ClassVar, Final, Self

from annotated_types import Gt, Interval, Le, Len
from pydantic import AfterValidator, ConfigDict, ValidationError, model_validator

from amr_slam.wire.messages import MapPart
from amr_slam.wire.values import (
    MAX_COMMAND_BYTES,
    Angle,
    Part,
    Payload,
    Text,
    WireError,
    complaint,
)

_FARTHEST_M: Final = 100_000.0
_LARGEST_RADIUS_M: Final = 10_000.0


def _file_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
        raise ValueError("should be 1 to 64 letters, digits, '_', '-' or '.', no '.' first")
    return name


def _reason(reason: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", reason):
        raise ValueError("should be 1 to 40 letters, digits, '_' or '-'")
    return reason


Metres = Annotated[float, Interval(ge=-_FARTHEST_M, le=_FARTHEST_M)]
Heading = Annotated[float, Interval(ge=-2.0 * math.pi, le=2.0 * math.pi)]
"""Either custom of angles is understood; most degrees taken for radians are not."""
MapName = Annotated[str, Len(1, 64), AfterValidator(_file_name)]
"""Becomes part of a file's name."""
Reason = Annotated[str, Len(1, 40), AfterValidator(_reason)]
"""Becomes part of a file's name."""


class Command(Payload):
    """Arguments of one command."""

    model_config = ConfigDict(extra="forbid")
    max_bytes: ClassVar[int] = MAX_COMMAND_BYTES

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Nothing at all is ``{}``. Raises WireError, one line, for anything that cannot be
        done."""
        return super().decode(payload or b"{}")


class SetPose(Command):
    """The robot is about here: it looks for its place around it, and takes what it finds."""

    kind: ClassVar[str] = "set_pose"
    x: Metres
    y: Metres
    theta: Heading
    radius: Annotated[float, Gt(0), Le(_LARGEST_RADIUS_M)]
    """How far off x and y may be, in m."""


class ResumePose(Command):
    """The robot is exactly here, as its controller knows: taken as it is, without a search."""

    kind: ClassVar[str] = "resume_pose"
    x: Metres
    y: Metres
    theta: Heading


class Relocalize(Command):
    """Forget the pose, and look for the place in the whole map."""

    kind: ClassVar[str] = "relocalize"


class StartMapping(Command):
    """Begin a new map here, or go on with the one in which the robot is localized."""

    kind: ClassVar[str] = "start_mapping"
    name: MapName
    extend: bool = False
    """The map of this name is the active one, and grows on."""
    hold: bool = True
    """Extending: what is in the map already stays as it is."""


class SaveMap(Command):
    """Save the active map under this name."""

    kind: ClassVar[str] = "save_map"
    name: MapName


class LoadMap(Command):
    """Localize in this map from now on."""

    kind: ClassVar[str] = "load_map"
    name: MapName


class SaveRecording(Command):
    """Save what the last minutes brought, for the reason given."""

    kind: ClassVar[str] = "save_recording"
    reason: Reason


COMMANDS: Final[Mapping[str, type[Command]]] = MappingProxyType(
    {
        command.kind: command
        for command in (
            SetPose,
            ResumePose,
            Relocalize,
            StartMapping,
            SaveMap,
            LoadMap,
            SaveRecording,
        )
    }
)
"""By the last part of their keys."""


def command_of(name: str, payload: bytes) -> Command:
    """The command with its arguments. Raises WireError, one line, when there is none of that name
    or the arguments are not its."""
    if name not in COMMANDS:
        raise WireError(f"{name:.40}: no such command; there are {', '.join(COMMANDS)}")
    return COMMANDS[name].decode(payload)


class FoundPose(Part):
    """Where a command has put the robot."""

    x: float
    y: float
    theta: Angle


class CommandReply(Payload):
    """What became of a command. ``ok``: done, or under way where it takes its time."""

    kind: ClassVar[str] = "reply"
    ok: bool
    error: Text | None = None
    """Why not, in one line."""
    pose: FoundPose | None = None
    """The pose that the robot has now, where the command was about that."""
    map: MapPart | None = None
    """The map that is active now, where the command was about that."""
    file: Text | None = None
    """What is written on the robot's disk."""

    @model_validator(mode="after")
    def _says_why(self) -> Self:
        if self.ok != (self.error is None):
            raise ValueError("error belongs to what is not ok, and to nothing else")
        return self

    @classmethod
    def refusing(cls, error: Exception | str) -> CommandReply:
        """``error`` in one line of bounded length."""
        if isinstance(error, ValidationError):
            error = complaint(error)
        text = str(error).encode(errors="replace").decode()  # names of files may be no text
        return cls(ok=False, error=" ".join(text.split())[:500] or "failed")
