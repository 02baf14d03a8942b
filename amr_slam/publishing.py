"""The robot on the Zenoh network, and whoever listens to robots. Zenoh is seen here and in
``serving`` only.

A robot is a *peer*: it opens at once with nobody there, serves those who connect to it, and looks
for its routers in the background for ever. Listeners are *clients*: a client is served both by a
robot directly and by a router (a router passes nothing from one peer on to another).
"""

from __future__ import annotations

import json
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Self, TypeVar

import zenoh

from amr_slam.keys import CredentialsError, read_credentials
from amr_slam.serving import CommandDesk, MapDesk, Put
from amr_slam.wire import (
    DEFAULT_ENDPOINT,
    MAX_MESSAGE_BYTES,
    PoseMessage,
    ScanMessage,
    StatusMessage,
    WireError,
    ZenohSettings,
    robot_key,
    robot_of,
)

_log = logging.getLogger(__name__)

_ENCODING: Final = zenoh.Encoding.APPLICATION_JSON
# Zenoh's own default is 1 GiB: anyone could fill the memory. A robot is sent commands only.
_MAX_HEARD_BYTES: Final = 1 << 20
_MAX_ASKED_BYTES: Final = 1 << 17
_MAX_ROBOTS: Final = 1000  # names come from the network: bounds what a listener remembers
_QUEUE_BATCHES: Final = 16  # the default of 2 loses poses when the processor is busy
_HANDSHAKE_MS: Final = 2000  # closing waits for one with a frozen router; zenoh's own is 10 s
_RETRY: Final = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}


_MessageT = TypeVar("_MessageT", PoseMessage, StatusMessage)


class PublishingError(Exception):
    """The session could not be opened: port in use, nobody at the endpoint, a name that makes no
    key. One line."""


def _open(
    options: dict[str, Any], endpoints: Sequence[str], keys: Path | None, most_bytes: int
) -> zenoh.Session:
    """``most_bytes``: of a message that comes in."""
    common: dict[str, Any] = {
        "connect/retry": _RETRY,
        "transport/unicast/open_timeout": _HANDSHAKE_MS,
        "transport/unicast/accept_timeout": _HANDSHAKE_MS,
        "transport/link/rx/max_message_size": most_bytes,
        "transport/link/tx/queue/size/real_time": _QUEUE_BATCHES,
        # Messages are small, and a killed process leaves its shared memory behind.
        "transport/shared_memory/enabled": False,
    }
    try:
        if keys is not None:
            options |= read_credentials(keys).options()
    except CredentialsError as error:
        raise PublishingError(str(error)) from error
    config = zenoh.Config()
    try:
        for key, value in (common | options).items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise PublishingError(f"zenoh {', '.join(endpoints)}: {_reason(error)}") from error


def _reason(error: zenoh.ZError) -> str:
    """What zenoh says, without the places in its sources and the names of its types."""
    text = " ".join(str(error).split(" at /", maxsplit=1)[0].rpartition('msg: "')[2].split())
    return "nobody answers" if text.startswith("Unable to connect") else text


@contextmanager
def _declaring(session: zenoh.Session) -> Iterator[None]:
    """Not left open when a name makes no key."""
    try:
        yield
    except zenoh.ZError as error:
        _close(session)
        raise PublishingError(f"zenoh: {_reason(error)}") from error


def _close(session: zenoh.Session) -> None:
    if session.is_closed():
        return
    try:
        session.close()  # type: ignore[no-untyped-call]  # zenoh's stub leaves the result open
    except zenoh.ZError as error:  # timed out on a frozen router: it is closed all the same
        _log.warning("zenoh: %s", _reason(error))


class _Topic:
    """Publishes under one key, and answers ``get`` with what was published last."""

    def __init__(self, session: zenoh.Session, key: str, priority: zenoh.Priority) -> None:
        self._key = key
        self._latest: bytes | None = None
        self._publisher = session.declare_publisher(
            key,
            encoding=_ENCODING,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=priority,
        )
        self._queryable = session.declare_queryable(key, self._answer)

    def put(self, payload: bytes) -> None:
        self._latest = payload
        self._publisher.put(payload)

    def _answer(self, query: zenoh.Query) -> None:
        latest = self._latest
        with query:
            if latest is not None:
                query.reply(self._key, latest, encoding=_ENCODING)


class RobotPublisher:
    """One robot's poses and status, its ``alive`` token, and the answers to ``get``.

    A context manager: a session that is not closed keeps the interpreter from ending. Publishing
    is for one thread and waits for nobody: with a full queue a message is dropped, as the next
    one is better.
    """

    def __init__(self, settings: ZenohSettings, robot: str) -> None:
        """Raises PublishingError when an endpoint cannot be listened on."""
        self._session = _open(
            {
                "mode": "peer",
                "listen/endpoints": settings.listen,
                "connect/endpoints": settings.connect,
                "connect/timeout_ms": -1,
                "connect/exit_on_failure": False,
                "scouting/multicast/enabled": settings.multicast_scouting,
                # Robots on one router would learn of each other and connect all to all.
                "scouting/gossip/enabled": False,
                "transport/link/tx/lease": settings.lease_ms,
            },
            (*settings.listen, *settings.connect),
            settings.keys,
            _MAX_ASKED_BYTES,
        )
        key = partial(robot_key, settings.prefix, robot)
        self._base = f"{settings.prefix}/{robot}"
        self._desks: tuple[CommandDesk | MapDesk, ...] = ()
        with _declaring(self._session):
            self._pose = _Topic(self._session, key("pose"), zenoh.Priority.REAL_TIME)
            self._status = _Topic(self._session, key("status"), zenoh.Priority.DATA_LOW)
            self._scan = _Topic(self._session, key("scan"), zenoh.Priority.BACKGROUND)
            self._alive = self._session.liveliness().declare_token(key("alive"))

    def publish_pose(self, message: PoseMessage) -> None:
        self._pose.put(message.encode())

    def publish_status(self, message: StatusMessage) -> None:
        self._status.put(message.encode())

    def publish_scan(self, message: ScanMessage) -> None:
        self._scan.put(message.encode())

    def serve(self, put: Put) -> None:
        """From now on, take commands and queries for the map, and have ``put`` do them: it gets
        an :class:`amr_slam.serving.Asked` on another thread and returns at once."""
        self._desks = (
            CommandDesk(self._session, self._base, put),
            MapDesk(self._session, self._base, put),
        )

    def close(self) -> None:
        """Idempotent. Listeners see the ``alive`` token fall."""
        for desk in self._desks:
            desk.close()
        _close(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


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
    refused: int = 0
    """Payloads under this robot's keys that were no messages of it."""

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
        queue_size: int = 1024,
    ) -> None:
        """``endpoint``: of a robot or a router; ``robots``: their names, none for all; ``keys``:
        folder that ``amr-slam keys fleet`` wrote.

        ``queue_size``: poses kept for :meth:`next_pose`; beyond it the oldest go.
        Raises PublishingError when nobody answers within ``connect_timeout_s``.
        """
        self._changed = threading.Condition()
        self._views = {robot: RobotView(robot=robot) for robot in robots}
        self._poses: deque[PoseMessage] = deque(maxlen=queue_size)
        self._session = _open(
            {
                "mode": "client",
                "connect/endpoints": [endpoint],
                "connect/timeout_ms": round(1000 * connect_timeout_s),
                "connect/exit_on_failure": True,
                "scouting/multicast/enabled": False,
            },
            (endpoint,),
            keys,
            _MAX_HEARD_BYTES,
        )
        with _declaring(self._session):
            for robot in robots or ("*",):
                key = partial(robot_key, prefix, robot)
                self._session.declare_subscriber(key("pose"), self._on_pose)
                self._session.declare_subscriber(key("status"), self._on_status)
                self._session.liveliness().declare_subscriber(
                    key("alive"), self._on_alive, history=True
                )

    def views(self) -> dict[str, RobotView]:
        """The robots seen so far and those asked for, by name."""
        with self._changed:
            return dict(self._views)

    def wait_for(self, condition: Callable[[dict[str, RobotView]], bool], timeout_s: float) -> bool:
        """Wait until ``condition(views)`` holds; False when it did not in time."""
        with self._changed:
            return self._changed.wait_for(lambda: condition(self._views), timeout_s)

    def next_pose(self, timeout_s: float) -> PoseMessage | None:
        """The next pose of any robot in order of arrival, or None when none came in time."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._poses), timeout_s)
            return self._poses.popleft() if self._poses else None

    def close(self) -> None:
        """Idempotent."""
        _close(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _on_pose(self, sample: zenoh.Sample) -> None:
        pose = self._decoded(PoseMessage, sample)
        if pose is not None and self._update(
            pose.robot, pose=pose, pose_received_s=time.monotonic()
        ):
            with self._changed:
                self._poses.append(pose)
                self._changed.notify_all()

    def _on_status(self, sample: zenoh.Sample) -> None:
        status = self._decoded(StatusMessage, sample)
        if status is not None:
            self._update(status.robot, status=status)

    def _on_alive(self, sample: zenoh.Sample) -> None:
        self._update(robot_of(str(sample.key_expr)), alive=sample.kind == zenoh.SampleKind.PUT)

    def _decoded(self, kind: type[_MessageT], sample: zenoh.Sample) -> _MessageT | None:
        """The message, or None, counted, when it is none or speaks for another robot."""
        robot = robot_of(str(sample.key_expr))
        if sample.kind == zenoh.SampleKind.PUT and len(sample.payload) <= MAX_MESSAGE_BYTES:
            with suppress(WireError):
                message = kind.decode(sample.payload.to_bytes())
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
            self._views[robot] = replace(view, refused=view.refused + refused, **changes)
            self._changed.notify_all()
            return True
