"""What an encoder is: the keys it speaks and listens on, and what it makes of a message."""

# ruff: noqa: ARG002  # an encoder that has none of something does nothing with it
from __future__ import annotations

import enum
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amr_slam.wire import (
    MAX_COMMAND_BYTES,
    Command,
    CommandReply,
    MapImage,
    PoseMessage,
    ScanMessage,
    StatusMessage,
)


class Lane(enum.Enum):
    """With which of the robot's own messages something goes; each has a priority of its own. They
    are dropped, never waited for, where the network is slow: the next one is better."""

    POSE = enum.auto()
    STATUS = enum.auto()
    SCAN = enum.auto()
    MAP = enum.auto()
    """Megabytes, once in a while, from a thread of their own: not dropped but waited for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlet:
    """A key that is published on."""

    key: str
    encoding: str
    """As Zenoh writes it: ``application/json``, ``application/cdr;std_msgs/msg/String``."""
    lane: Lane
    answers: bool = False
    """Whether a ``get`` of the key is answered with what was published last."""
    latched: bool = False
    """Whether Zenoh's advanced subscribers are given what was published before they came."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoded:
    """Something to publish."""

    key: str
    """Of one of the encoder's outlets."""
    payload: bytes
    attachment: bytes | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapPicture:
    """The active map as pixels."""

    seq: int
    """+1 each picture since the start."""
    stamp: float
    """UTC seconds of its drawing."""
    pixels: NDArray[np.uint8]
    """(rows, columns) of :mod:`amr_slam.map.export`'s OCCUPIED, UNKNOWN and FREE; the first row has
    the greatest y."""
    georeference: MapImage


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """A command that came in on an inlet."""

    command: Command
    answered: Callable[[CommandReply], object] | None = None
    """Told what became of it, on another thread than the encoder's other methods are called on:
    there is nobody to reply to on a key that is published on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inlet:
    """A key that is listened on for commands in another form than ``cmd/<command>``.

    Whoever may publish on it may command the robot: access control has to cover it.
    """

    key: str
    """No key expression: each inlet is one robot's."""
    name: str
    """What the log calls it."""
    decode: Callable[[bytes], Request | None]
    """On a thread of zenoh's. Raises WireError, one line, for what cannot be done; None for what is
    meant for somebody else."""
    max_bytes: int = MAX_COMMAND_BYTES
    """Larger payloads are refused unread."""


class Encoder:
    """One further form; what it has none of stays as it is here.

    The methods that make messages are called on the loop's thread, at the poses' rate: they wait
    for nothing and take microseconds.
    """

    outlets: Sequence[Outlet] = ()
    """All keys that it ever publishes on."""
    inlets: Sequence[Inlet] = ()

    def tokens(self, session_id: str) -> Sequence[str]:
        """Keys of the liveliness tokens to hold. ``session_id``: Zenoh's, in hexadecimal."""
        return ()

    def pose(self, message: PoseMessage) -> Iterable[Encoded]:
        return ()

    def status(self, message: StatusMessage) -> Iterable[Encoded]:
        return ()

    def scan(self, message: ScanMessage) -> Iterable[Encoded]:
        return ()

    def map(self, picture: MapPicture) -> Iterable[Encoded]:
        """On another thread: may take its time. Called only with an outlet on :attr:`Lane.MAP`."""
        return ()
