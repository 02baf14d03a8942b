"""What Foxglove draws of a recording: made from the messages in it, as they are written.

Nothing of this is kept in memory beside the messages, and no replay reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Final, NamedTuple

from amr_slam import foxglove
from amr_slam.geometry import Pose2

_BASE: Final = "base"
_LEAST_NS: Final = 100_000_000
"""Between two drawn poses: ten a second look like a drive, fifty would double the file."""

_NO_MESSAGE: Final = (AttributeError, KeyError, TypeError, ValueError)


class Drawn(NamedTuple):
    """A message for one of Foxglove's schemas."""

    topic: str
    schema: str
    stamp_ns: int
    fields: foxglove.Fields


class Drawing:
    """Follows one recording."""

    def __init__(self, mountings: Mapping[str, Pose2]) -> None:
        """``mountings``: base_from_lidar by the scanner's name, which is its frame's as well."""
        self._mountings = dict(mountings)
        self._robot: foxglove.Robot | None = None
        self._health: foxglove.Health | None = None
        self._next_ns = 0
        self._begun = False

    def of(self, topic: str, stamp_ns: int, data: bytes) -> Iterator[Drawn]:
        """What is to be drawn beside the message ``data`` of ``topic``; of one that is none of ours
        nothing: no recording fails for want of a picture."""
        if not self._begun:
            self._begun = True
            if self._mountings:
                mounted = foxglove.transforms(stamp_ns, _BASE, self._mountings)
                yield Drawn("/tf_static", foxglove.TRANSFORMS, stamp_ns, mounted)
        with suppress(*_NO_MESSAGE):
            yield from self._of_message(topic, stamp_ns, data)

    def _of_message(self, topic: str, stamp_ns: int, data: bytes) -> Iterator[Drawn]:
        if topic == "/pose" and stamp_ns >= self._next_ns:
            self._next_ns = stamp_ns + _LEAST_NS
            yield from self._pose(stamp_ns, json.loads(data))
        elif topic == "/truth" and stamp_ns >= self._next_ns:  # simulated: there are no poses
            self._next_ns = stamp_ns + _LEAST_NS
            yield Drawn("/tf", foxglove.TRANSFORMS, stamp_ns, _where(stamp_ns, json.loads(data)))
        elif topic == "/status":
            yield from self._status(stamp_ns, json.loads(data))

    def _pose(self, stamp_ns: int, pose: dict[str, Any]) -> Iterator[Drawn]:
        robot = self._of(pose)
        moved = robot.transforms(stamp_ns, pose)
        yield Drawn("/tf", foxglove.TRANSFORMS, stamp_ns, moved)
        yield Drawn("/scene", foxglove.SCENE_UPDATE, stamp_ns, robot.scene(stamp_ns, pose))

    def _status(self, stamp_ns: int, status: dict[str, Any]) -> Iterator[Drawn]:
        robot = self._of(status)
        if status.get("candidates"):
            places = robot.candidates(stamp_ns, status)
            yield Drawn("/scene", foxglove.SCENE_UPDATE, stamp_ns, places)
        if self._health is None:
            self._health = foxglove.Health(robot.name)
        for line in self._health.lines(stamp_ns, status):
            yield Drawn("/health", foxglove.LOG, stamp_ns, line)

    def _of(self, message: dict[str, Any]) -> foxglove.Robot:
        if self._robot is None:
            self._robot = foxglove.Robot(name=str(message["robot"]), base_frame=_BASE)
        return self._robot


def _where(stamp_ns: int, truth: dict[str, Any]) -> foxglove.Fields:
    at = truth["pose"]["position"]
    pose = Pose2(at["x"], at["y"], truth["theta"])
    return foxglove.transforms(stamp_ns, truth["frame_id"], {_BASE: pose})
