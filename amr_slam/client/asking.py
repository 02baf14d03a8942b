"""Questions to one robot: commands, its map, and the picture of it. They wait for the answer."""

from __future__ import annotations

from typing import Final

import zenoh

from amr_slam.client.session import reason
from amr_slam.wire import (
    MAX_MAP_BYTES,
    MAX_MESSAGE_BYTES,
    Command,
    CommandReply,
    MapChanges,
    MapImage,
    ScanMessage,
    Topic,
    WireError,
    command_key,
    robot_key,
)

_MAX_ERROR: Final = 200
_BULK: Final = zenoh.Priority.DATA_LOW
"""A reply goes at its query's priority: what is large must not stand before the poses."""


class AskingError(Exception):
    """No answer, or one that is none. One line."""


class CommandRefusedError(AskingError):
    """The robot has answered that it did not do it, and why."""


def call(
    session: zenoh.Session, prefix: str, robot: str, command: Command, timeout_s: float
) -> CommandReply:
    """The robot's reply, whatever it says. Raises AskingError when none came within ``timeout_s``,
    or something else."""
    key = command_key(prefix, robot, command.kind)
    reply = _ask(session, key, MAX_MESSAGE_BYTES, timeout_s, command.encode())
    try:
        return CommandReply.decode(reply.payload.to_bytes())
    except WireError as error:
        raise AskingError(f"{key}: {error}") from error


def ask_map(
    session: zenoh.Session,
    prefix: str,
    robot: str,
    timeout_s: float,
    max_bytes: int = MAX_MAP_BYTES,
) -> bytes:
    """The active map as .amrmap, ``max_bytes`` at most. Raises AskingError."""
    key = robot_key(prefix, robot, Topic.MAP)
    return _ask(session, key, max_bytes, timeout_s, priority=_BULK).payload.to_bytes()


def ask_map_image(
    session: zenoh.Session,
    prefix: str,
    robot: str,
    timeout_s: float,
    max_bytes: int = MAX_MAP_BYTES,
) -> tuple[bytes, MapImage]:
    """A PNG of the active map, and where it lies. Raises AskingError."""
    key = robot_key(prefix, robot, Topic.MAP_IMAGE)
    reply = _ask(session, key, max_bytes, timeout_s, priority=_BULK)
    if reply.attachment is None or len(reply.attachment) > MAX_MESSAGE_BYTES:
        raise AskingError(f"{key}: the picture does not say where it lies")
    try:
        return reply.payload.to_bytes(), MapImage.decode(reply.attachment.to_bytes())
    except WireError as error:
        raise AskingError(f"{key}: {error}") from error


def ask_map_changes(
    session: zenoh.Session, prefix: str, robot: str, timeout_s: float
) -> MapChanges:
    """What has changed in the place since its map was made. Raises AskingError."""
    key = robot_key(prefix, robot, Topic.MAP_CHANGES)
    reply = _ask(session, key, MAX_MESSAGE_BYTES, timeout_s, priority=_BULK)
    try:
        return MapChanges.decode(reply.payload.to_bytes())
    except WireError as error:
        raise AskingError(f"{key}: {error}") from error


def ask_scan(
    session: zenoh.Session, prefix: str, robot: str, timeout_s: float, points: int
) -> ScanMessage:
    """The newest scan, thinned by the robot to so many points. Raises AskingError."""
    key = robot_key(prefix, robot, Topic.SCAN)
    reply = _ask(
        session, key, MAX_MESSAGE_BYTES, timeout_s, priority=_BULK, parameters=f"?points={points}"
    )
    try:
        return ScanMessage.decode(reply.payload.to_bytes())
    except WireError as error:
        raise AskingError(f"{key}: {error}") from error


def _ask(
    session: zenoh.Session,
    key: str,
    max_bytes: int,
    timeout_s: float,
    payload: bytes | None = None,
    *,
    priority: zenoh.Priority = zenoh.Priority.DATA_HIGH,
    parameters: str = "",
) -> zenoh.Sample:
    if "*" in key:
        raise AskingError(f"{key}: one robot at a time")
    try:
        # Replies are waited for one by one; zenoh's queue holds few, and the first one counts.
        replies = session.get(
            key + parameters,
            payload=payload,
            encoding=zenoh.Encoding.APPLICATION_JSON,
            timeout=timeout_s,
            priority=priority,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        reply = next(iter(replies), None)
    except zenoh.ZError as error:
        raise AskingError(f"{key}: {reason(error)}") from error
    if reply is None:
        raise AskingError(f"{key}: no answer")
    if reply.err is not None:
        text = reply.err.payload.to_bytes()[:_MAX_ERROR].decode(errors="replace")
        raise AskingError(f"{key}: {' '.join(text.split()) or 'no answer'}")
    sample = reply.ok
    if sample is None or len(sample.payload) > max_bytes:
        raise AskingError(f"{key}: the answer has more than {max_bytes} bytes")
    return sample
