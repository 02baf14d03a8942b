"""What is asked of the loop on the network's side, and what becomes of it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from amr_slam.wire import Command, MapImage


class NotDone(Exception):  # noqa: N818  # no fault of the program: an answer
    """Why something that was asked for was not done: one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWanted:
    """The active map's file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageWanted:
    """A picture of the active map."""

    resolution_m: float | None
    """Side of a pixel; None: of a wall cell."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangesWanted:
    """What has changed in the place since the active map was made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFile:
    """Where the active map is, whole."""

    path: Path
    map_id: str
    """UUID of its content."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A PNG picture of the active map."""

    png: bytes
    georeference: MapImage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Asked:
    """Something for the loop to do. Whoever asks may give up: then the answer is cancelled."""

    request: Command | MapWanted | ImageWanted | ChangesWanted
    by: str
    """Who, as far as zenoh tells."""
    answer: Future[Any] = field(default_factory=Future)
    """CommandReply, MapFile, Picture or MapChanges; or NotDone."""

    def done(self, result: object) -> None:
        """Answer it; nothing happens where nobody waits any more."""
        if self.answer.set_running_or_notify_cancel():
            self.answer.set_result(result)

    def not_done(self, reason: str) -> None:
        """The same without success."""
        if self.answer.set_running_or_notify_cancel():
            self.answer.set_exception(NotDone(reason))


Put = Callable[[Asked], object]
"""Has it done; returns at once; any thread."""
