"""The robot on the Zenoh network: what it says by itself; what it answers is ``serving``.

A robot is a *peer*: it opens at once with nobody there, serves those who connect to it, and looks
for its routers in the background for ever. Listeners (:mod:`amr_slam.client`) are *clients*: a
client is served both by a robot directly and by a router (a router passes nothing from one peer
on to another).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Final, Self

import zenoh
import zenoh.ext

from amr_slam.client.session import close_session, declaring, open_session
from amr_slam.encodings import Encoded, Encoder, Lane, MapPicture, Outlet
from amr_slam.map.export import png_pixels
from amr_slam.sender import Sender
from amr_slam.serving import (
    CommandDesk,
    Desk,
    InletDesk,
    MapDesk,
    MapTeller,
    NotDone,
    Picture,
    Put,
    thinned,
)
from amr_slam.wire import PoseMessage, ScanMessage, StatusMessage, Topic, ZenohSettings, robot_key

_JSON: Final = "application/json"
_MAX_INBOUND_BYTES: Final = 1 << 17  # commands are all that a robot is sent
_WAITING_POSES: Final = 25  # half a second of them, in each form
_WAITING_OTHERS: Final = 4
_HEARTBEAT_S: Final = 5.0
"""Between the numbers of the newest message on a latched key: who has lost it asks for it."""
_PRIORITIES: Final[Mapping[Lane, zenoh.Priority]] = MappingProxyType(
    {
        Lane.POSE: zenoh.Priority.REAL_TIME,
        Lane.STATUS: zenoh.Priority.INTERACTIVE_LOW,
        Lane.SCAN: zenoh.Priority.BACKGROUND,
        Lane.MAP: zenoh.Priority.DATA_LOW,
    }
)


_Selecting = Callable[[bytes, zenoh.Parameters], bytes]
"""What of the latest message a query asks for; raises NotDone where it asks for nonsense."""


def _whole(payload: bytes, _parameters: zenoh.Parameters) -> bytes:
    return payload


class _Topic:
    """Publishes under one key, and answers ``get`` with what was published last."""

    def __init__(
        self,
        session: zenoh.Session,
        outlet: Outlet,
        sender: Sender | None,
        select: _Selecting = _whole,
    ) -> None:
        """``sender``: puts instead of whoever calls :meth:`put`, who has no time to wait."""
        self._sender = sender
        self._select = select
        self._key = outlet.key
        self._encoding = zenoh.Encoding(outlet.encoding)
        self._latest: tuple[bytes, bytes | None] | None = None
        self._publisher = _publisher(session, outlet)
        self._queryable = (
            session.declare_queryable(self._key, self._answer) if outlet.answers else None
        )

    def put(self, payload: bytes, attachment: bytes | None = None) -> None:
        if self._queryable is not None:
            self._latest = payload, attachment
        send = partial(self._publisher.put, payload, attachment=attachment)
        if self._sender is None:
            send()
        else:
            self._sender.send(send)

    def _answer(self, query: zenoh.Query) -> None:
        latest = self._latest
        with query:
            if latest is not None:
                payload, attachment = latest
                try:
                    selected = self._select(payload, query.parameters)
                except NotDone as error:
                    query.reply_err(str(error).encode(), encoding=zenoh.Encoding.TEXT_PLAIN)
                else:
                    query.reply(self._key, selected, encoding=self._encoding, attachment=attachment)


def _publisher(
    session: zenoh.Session, outlet: Outlet
) -> zenoh.Publisher | zenoh.ext.AdvancedPublisher:
    control = zenoh.CongestionControl
    waits = control.BLOCK if outlet.lane is Lane.MAP else control.DROP
    priority = _PRIORITIES[outlet.lane]
    if not outlet.latched:
        return session.declare_publisher(
            outlet.key, encoding=outlet.encoding, congestion_control=waits, priority=priority
        )
    return zenoh.ext.declare_advanced_publisher(
        session,
        outlet.key,
        encoding=outlet.encoding,
        congestion_control=waits,
        priority=priority,
        cache=zenoh.ext.CacheConfig(max_samples=1),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(
            heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S
        ),
        publisher_detection=True,
    )


class RobotPublisher:
    """One robot's poses and status, its ``alive`` token, and the answers to ``get``.

    A context manager: a session that is not closed keeps the interpreter from ending. Publishing
    is for one thread and waits for nobody: with a full queue a message is dropped, as the next
    one is better.

    Priorities: poses before all else; no topic shares one with maps (answered at the query's, which
    is DATA_LOW by :mod:`amr_slam.client` and DATA by default), as who puts at the priority of a map
    that is under way waits for its end.
    """

    def __init__(
        self, settings: ZenohSettings, robot: str, encoders: Sequence[Encoder] = ()
    ) -> None:
        """``encoders``: make further forms of each message. Raises SessionError when an endpoint
        cannot be listened on."""
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
        self._desks: tuple[Desk | MapDesk | MapTeller, ...] = ()
        self._commands: CommandDesk | None = None
        self._inlets: InletDesk | None = None
        self._teller: MapTeller | None = None
        self._pictures = 0
        self._encoders = tuple(encoders)
        self._every = settings.fleet_every
        lanes = [outlet.lane for encoder in self._encoders for outlet in encoder.outlets]
        of_poses, of_maps = lanes.count(Lane.POSE), lanes.count(Lane.MAP)
        poses = Sender("poses", _WAITING_POSES * (1 + of_poses))
        others = Sender("others", _WAITING_OTHERS * (1 + len(lanes) - of_poses - of_maps))
        self._senders = {Lane.POSE: poses, Lane.STATUS: others, Lane.SCAN: others}
        with declaring(self._session):
            self._pose = self._topic(key(Topic.POSE), Lane.POSE)
            self._fleet_pose = self._topic(key(Topic.FLEET_POSE), Lane.POSE)
            self._status = self._topic(key(Topic.STATUS), Lane.STATUS)
            self._scan = self._topic(key(Topic.SCAN), Lane.SCAN, thinned)
            self._further = {
                outlet.key: _Topic(self._session, outlet, self._senders.get(outlet.lane))
                for encoder in self._encoders
                for outlet in encoder.outlets
            }
            self._tokens = [
                self._session.liveliness().declare_token(token)
                for token in (key(Topic.ALIVE), *self._further_tokens())
            ]

    def _topic(self, key: str, lane: Lane, select: _Selecting = _whole) -> _Topic:
        outlet = Outlet(key=key, encoding=_JSON, lane=lane, answers=True)
        return _Topic(self._session, outlet, self._senders[lane], select)

    def command_counts(self) -> Mapping[str, int]:
        """What became of the commands so far (:class:`amr_slam.wire.StatusMessage`). Any thread."""
        return {} if self._commands is None else self._commands.counts()

    @property
    def refused(self) -> int:
        """How many payloads came in on the encoders' inlets and were not done."""
        return 0 if self._inlets is None else self._inlets.refused

    def publish_pose(self, message: PoseMessage) -> None:
        self._pose.put(message.encode())
        if self._every and message.seq % self._every == 0:
            self._fleet_pose.put(message.model_copy(update={"every": self._every}).encode())
        for encoder in self._encoders:
            self._put_all(encoder.pose(message))

    def publish_status(self, message: StatusMessage) -> None:
        self._status.put(message.encode())
        for encoder in self._encoders:
            self._put_all(encoder.status(message))
        if self._teller is not None:
            self._teller.follow(message)

    def publish_scan(self, message: ScanMessage) -> None:
        self._scan.put(message.encode())
        for encoder in self._encoders:
            self._put_all(encoder.scan(message))

    def serve(self, put: Put) -> None:
        """From now on, take commands and queries for the map, and have ``put`` do them: it gets
        an :class:`amr_slam.serving.Asked` on another thread and returns at once."""
        desk = Desk("commands", put, places=1)  # one for all: one command at a time in any form
        self._desks = (desk, MapDesk(self._session, self._base, put))
        self._commands = CommandDesk(self._session, self._base, desk)
        inlets = [inlet for encoder in self._encoders for inlet in encoder.inlets]
        if inlets:
            self._inlets = InletDesk(self._session, inlets, desk)
        outlets = [outlet for encoder in self._encoders for outlet in encoder.outlets]
        if any(outlet.lane is Lane.MAP for outlet in outlets):
            self._teller = MapTeller(put, self._tell_map)
            self._desks += (self._teller,)

    def hear(self, key: str, put: Callable[[bytes], object]) -> None:
        """From now on, hand what others publish on a key expression to ``put``, which gets it on
        a thread of zenoh's and returns at once. Raises SessionError where it is none."""

        def on_sample(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                put(sample.payload.to_bytes())

        with declaring(self._session):
            self._session.declare_subscriber(key, on_sample)

    def close(self) -> None:
        """Idempotent. Listeners see the ``alive`` token fall."""
        for desk in self._desks:
            desk.close()
        for sender in set(self._senders.values()):
            sender.close()
        close_session(self._session)

    def _tell_map(self, picture: Picture) -> None:
        """On the teller's thread."""
        drawn = MapPicture(
            seq=self._pictures,
            stamp=time.time(),
            pixels=png_pixels(picture.png),
            georeference=picture.georeference,
        )
        self._pictures += 1
        for encoder in self._encoders:
            self._put_all(encoder.map(drawn))

    def _put_all(self, all_encoded: Iterable[Encoded]) -> None:
        for encoded in all_encoded:
            self._further[encoded.key].put(encoded.payload, encoded.attachment)

    def _further_tokens(self) -> list[str]:
        session_id = str(self._session.zid())
        return [token for encoder in self._encoders for token in encoder.tokens(session_id)]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
