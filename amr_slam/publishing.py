"""The robot on the Zenoh network: what it says by itself; what it answers is ``serving``.

A robot is a *peer*: it opens at once with nobody there, serves those who connect to it, and looks
for its routers in the background for ever. Listeners (:mod:`amr_slam.client`) are *clients*: a
client is served both by a robot directly and by a router (a router passes nothing from one peer
on to another).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, Self

import zenoh

from amr_slam.client.session import close_session, declaring, open_session
from amr_slam.lane import Lane
from amr_slam.serving import CommandDesk, MapDesk, NotDone, Put, thinned
from amr_slam.wire import PoseMessage, ScanMessage, StatusMessage, Topic, ZenohSettings, robot_key

_ENCODING: Final = zenoh.Encoding.APPLICATION_JSON
_MAX_INBOUND_BYTES: Final = 1 << 17  # commands are all that a robot is sent
_WAITING_POSES: Final = 25  # half a second of them
_WAITING_OTHERS: Final = 4


_Selecting = Callable[[bytes, zenoh.Parameters], bytes]
"""What of the latest message a query asks for; raises NotDone where it asks for nonsense."""


def _whole(payload: bytes, _parameters: zenoh.Parameters) -> bytes:
    return payload


class _Topic:
    """Publishes under one key, and answers ``get`` with what was published last."""

    def __init__(
        self,
        session: zenoh.Session,
        lane: Lane,
        key: str,
        priority: zenoh.Priority,
        select: _Selecting = _whole,
    ) -> None:
        self._lane = lane
        self._key = key
        self._select = select
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
        self._lane.put(self._publisher, payload)

    def _answer(self, query: zenoh.Query) -> None:
        latest = self._latest
        with query:
            if latest is not None:
                try:
                    query.reply(
                        self._key, self._select(latest, query.parameters), encoding=_ENCODING
                    )
                except NotDone as error:
                    query.reply_err(str(error).encode(), encoding=zenoh.Encoding.TEXT_PLAIN)


class RobotPublisher:
    """One robot's poses and status, its ``alive`` token, and the answers to ``get``.

    A context manager: a session that is not closed keeps the interpreter from ending. Publishing
    is for one thread and waits for nobody: with a full queue a message is dropped, as the next
    one is better.

    Priorities: poses before all else; no topic shares one with maps (answered at the query's, which
    is DATA_LOW by :mod:`amr_slam.client` and DATA by default), as who puts at the priority of a map
    that is under way waits for its end.
    """

    def __init__(self, settings: ZenohSettings, robot: str) -> None:
        """Raises SessionError when an endpoint cannot be listened on."""
        self._session = open_session(
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
                "transport/link/rx/max_message_size": _MAX_INBOUND_BYTES,
            },
            (*settings.listen, *settings.connect),
            settings.keys,
        )
        key = partial(robot_key, settings.prefix, robot)
        self._base = f"{settings.prefix}/{robot}"
        self._every = settings.fleet_every
        self._commands: CommandDesk | None = None
        self._maps: MapDesk | None = None
        self._poses, self._others = Lane("poses", _WAITING_POSES), Lane("others", _WAITING_OTHERS)
        topic = partial(_Topic, self._session)
        real_time = zenoh.Priority.REAL_TIME
        with declaring(self._session):
            self._pose = topic(self._poses, key(Topic.POSE), real_time)
            self._fleet_pose = topic(self._poses, key(Topic.FLEET_POSE), real_time)
            self._status = topic(self._others, key(Topic.STATUS), zenoh.Priority.INTERACTIVE_LOW)
            self._scan = topic(self._others, key(Topic.SCAN), zenoh.Priority.BACKGROUND, thinned)
            self._alive = self._session.liveliness().declare_token(key(Topic.ALIVE))

    def publish_pose(self, message: PoseMessage) -> None:
        self._pose.put(message.encode())
        if self._every and message.seq % self._every == 0:
            self._fleet_pose.put(message.model_copy(update={"every": self._every}).encode())

    def publish_status(self, message: StatusMessage) -> None:
        self._status.put(message.encode())

    def publish_scan(self, message: ScanMessage) -> None:
        self._scan.put(message.encode())

    def serve(self, put: Put) -> None:
        """From now on, take commands and queries for the map, and have ``put`` do them: it gets
        an :class:`amr_slam.serving.Asked` on another thread and returns at once."""
        self._commands = CommandDesk(self._session, self._base, put)
        self._maps = MapDesk(self._session, self._base, put)

    def command_counts(self) -> Mapping[str, int]:
        """What became of the commands so far (:class:`amr_slam.wire.StatusMessage`). Any thread."""
        return {} if self._commands is None else self._commands.counts()

    def close(self) -> None:
        """Idempotent. Listeners see the ``alive`` token fall."""
        for desk in (self._commands, self._maps):
            if desk is not None:
                desk.close()
        self._poses.close()
        self._others.close()
        close_session(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
