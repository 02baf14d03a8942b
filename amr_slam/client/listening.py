"""Whoever listens to robots: the newest of each, for programs with threads."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Self, TypeVar

import zenoh

from amr_slam.client.session import SessionError, close_session, declaring, open_client, reason
from amr_slam.wire import (
    DEFAULT_ENDPOINT,
    MAX_MESSAGE_BYTES,
    PoseMessage,
    ScanMessage,
    StatusMessage,
    Topic,
    WireError,
    robot_key,
    robot_of,
)

_MAX_ROBOTS: Final = 1000  # names come from the network: bounds what a listener remembers

_ASK_S: Final = 5.0  # a robot that is alive answers at once, or is heard within a second
_MessageT = TypeVar("_MessageT", PoseMessage, StatusMessage, ScanMessage)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotView:
    """What a listener knows of one robot."""

    robot: str
    alive: bool = False
    """The robot's process is there and connected. No word on its pose: see ``pose_age_s``."""
    pose: PoseMessage | None = None
    status: StatusMessage | None = None
    pose_received_s: float = -math.inf
    """``time.monotonic()`` at which the newest pose came in."""
    lost: int = 0
    """Poses that were sent and did not come in, by the gaps in their numbers."""
    restarts: int = 0
    """How often the numbers began anew: the robot's program was started again."""
    refused: int = 0
    """Payloads under this robot's keys that were no messages of it."""
    poses: int = 0
    """Poses that came in."""
    scan: ScanMessage | None = None
    """The newest, while :meth:`FleetListener.follow_scans` is at work."""

    def pose_age_s(self) -> float:
        """Seconds since a pose came in, on this machine's clock alone; inf before the first."""
        return time.monotonic() - self.pose_received_s


class FleetListener:
    """Follows the poses, status and liveliness of some robots, or of all.

    A context manager. Messages arrive on zenoh's own threads; all methods may be called from any.
    """

    def __init__(
        self,
        endpoint: str = DEFAULT_ENDPOINT,
        robots: Sequence[str] = (),
        *,
        prefix: str = "amr",
        keys: Path | None = None,
        connect_timeout_s: float = 10.0,
        full_rate: bool = True,
        queue_size: int = 1024,
        on_change: Callable[[str], None] = lambda _: None,
    ) -> None:
        """``endpoint``: of a robot or a router; ``robots``: their names, none for all; ``keys``:
        folder that ``amr-slam keys fleet`` wrote.

        ``full_rate``: False follows every n-th pose (``fleet_pose``; ``zenoh.fleet_every``).
        ``queue_size``: poses kept for :meth:`next_pose`; beyond it the oldest go.
        ``on_change``: called on zenoh's threads with the name of a robot of which something new
        is known; must neither wait nor raise.
        Raises SessionError when nobody answers within ``connect_timeout_s``.
        """
        self._on_change = on_change
        self._changed = threading.Condition()
        self._views = {robot: RobotView(robot=robot) for robot in robots}
        self._poses: deque[PoseMessage] = deque(maxlen=queue_size)
        self._prefix = prefix
        self._session = open_client(endpoint, keys, connect_timeout_s)
        pose = Topic.POSE if full_rate else Topic.FLEET_POSE
        with declaring(self._session):
            for robot in robots or ("*",):
                key = partial(robot_key, prefix, robot)
                self._session.declare_subscriber(key(pose), self._on_pose)
                self._session.declare_subscriber(key(Topic.STATUS), self._on_status)
                self._session.liveliness().declare_subscriber(
                    key(Topic.ALIVE), self._on_alive, history=True
                )

    def views(self) -> dict[str, RobotView]:
        """The robots seen so far and those asked for, by name."""
        with self._changed:
            return dict(self._views)

    def view(self, robot: str) -> RobotView:
        """One robot, known or not."""
        with self._changed:
            return self._views.get(robot) or RobotView(robot=robot)

    def wait_for(self, condition: Callable[[dict[str, RobotView]], bool], timeout_s: float) -> bool:
        """Wait until ``condition(views)`` holds; False when it did not in time."""
        with self._changed:
            return self._changed.wait_for(lambda: condition(self._views), timeout_s)

    def next_pose(self, timeout_s: float) -> PoseMessage | None:
        """The next pose of any robot in order of arrival, or None when none came in time."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._poses), timeout_s)
            return self._poses.popleft() if self._poses else None

    def follow_scans(self, robot: str) -> zenoh.Subscriber[None]:
        """From now on, keep the robot's newest scan in its view; ``undeclare()`` ends it. Raises
        SessionError when the name makes no key."""
        try:
            return self._session.declare_subscriber(
                robot_key(self._prefix, robot, Topic.SCAN), self._on_scan
            )
        except zenoh.ZError as error:
            raise SessionError(f"zenoh: {reason(error)}") from error

    @property
    def session(self) -> zenoh.Session:
        """For asking the robots (:mod:`amr_slam.client.asking`)."""
        return self._session

    def close(self) -> None:
        """Idempotent."""
        close_session(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _on_pose(self, sample: zenoh.Sample) -> None:
        pose = self._decoded(PoseMessage, sample)
        if pose is not None and self._update(
            pose.robot, pose=pose, pose_received_s=time.monotonic()
        ):
            self._on_change(pose.robot)

    def _on_status(self, sample: zenoh.Sample) -> None:
        status = self._decoded(StatusMessage, sample)
        if status is not None:
            self._update(status.robot, status=status)
            self._on_change(status.robot)

    def _on_scan(self, sample: zenoh.Sample) -> None:
        scan = self._decoded(ScanMessage, sample)
        if scan is not None:
            self._update(scan.robot, scan=scan)
            self._on_change(scan.robot)

    def _on_alive(self, sample: zenoh.Sample) -> None:
        robot = robot_of(str(sample.key_expr))
        alive = sample.kind == zenoh.SampleKind.PUT
        if self._update(robot, alive=alive) and alive:
            # Said once a second only. A pose comes sooner than it could be asked for, and one that
            # was asked for might be of a robot that has long said nothing.
            with suppress(zenoh.ZError):  # the session closes
                key = robot_key(self._prefix, robot, Topic.STATUS)
                self._session.get(
                    key, self._on_status_reply, timeout=_ASK_S, priority=zenoh.Priority.DATA_LOW
                )
        self._on_change(robot)

    def _on_status_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._on_status(reply.ok)

    def _decoded(self, kind: type[_MessageT], sample: zenoh.Sample) -> _MessageT | None:
        """The message, or None, counted, when it is none or speaks for another robot."""
        robot, payload = robot_of(str(sample.key_expr)), sample.payload
        if sample.kind == zenoh.SampleKind.PUT and len(payload) <= MAX_MESSAGE_BYTES:
            with suppress(WireError):
                message = kind.decode(payload.to_bytes())
                if message.robot == robot:
                    return message
        self._update(robot, refused=1)
        return None

    def _update(self, robot: str, *, refused: int = 0, **changes: Any) -> bool:
        """Change one robot's view; False for one robot too many."""
        with self._changed:
            view = self._views.get(robot)
            if view is None:
                if len(self._views) >= _MAX_ROBOTS:
                    return False
                view = RobotView(robot=robot)
            if "pose" in changes:
                changes |= _counted(view, changes["pose"])
                self._poses.append(changes["pose"])
            self._views[robot] = replace(view, refused=view.refused + refused, **changes)
            self._changed.notify_all()
            return True


def _counted(view: RobotView, pose: PoseMessage) -> dict[str, int]:
    """What the number of a new pose tells. Zenoh keeps the order of one sender's messages."""
    poses = view.poses + 1
    if view.pose is None:
        return {"poses": poses}
    if pose.seq <= view.pose.seq:
        return {"poses": poses, "restarts": view.restarts + 1}
    return {"poses": poses, "lost": view.lost + (pose.seq - view.pose.seq - 1) // pose.every}
