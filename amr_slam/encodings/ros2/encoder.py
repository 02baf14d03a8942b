"""Poses, wheels, transforms, scans and health for ROS 2."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Final

from amr_slam.encodings.base import (
    Encoded,
    Encoder,
    Inlet,
    Lane,
    MapPicture,
    Outlet,
    Request,
)
from amr_slam.encodings.ros2 import messages
from amr_slam.encodings.ros2.initialpose import read_initialpose
from amr_slam.encodings.ros2.keys import (
    DIAGNOSTICS,
    GRID,
    ODOMETRY,
    POINTS,
    POSE,
    TRANSFORMS,
    Graph,
    Topic,
    attachment,
    gid,
)
from amr_slam.encodings.ros2.settings import Ros2Settings
from amr_slam.geometry import Pose2
from amr_slam.states import State
from amr_slam.wire import PoseMessage, ScanMessage, StatusMessage

_POSE: Final = Topic(name="pose", type=POSE)
_ODOM: Final = Topic(name="odom", type=ODOMETRY)
_TF: Final = Topic(name="tf", type=TRANSFORMS)
_POINTS: Final = Topic(name="scan_points", type=POINTS)
_DIAGNOSTICS: Final = Topic(name="diagnostics", type=DIAGNOSTICS)
_MAP: Final = Topic(name="map", type=GRID, latched=True)
INITIALPOSE: Final = Topic(name="initialpose", type=POSE)
"""The one topic that is listened on."""
_LANES: Final = {
    _POSE: Lane.POSE,
    _ODOM: Lane.POSE,
    _TF: Lane.POSE,
    _POINTS: Lane.SCAN,
    _DIAGNOSTICS: Lane.STATUS,
    _MAP: Lane.MAP,
}
PUBLISHED: Final = tuple(_LANES)
"""All topics that a robot may publish."""
_KNOWN_PLACE: Final = frozenset({State.LOCALIZED, State.MAPPING, State.ODOMETRY_ONLY})
"""States in which a robot may drive by its place in the map. ROS messages have no field that says
so: in the others the place is withheld, and its readers notice that it grows old."""


class Ros2Encoder(Encoder):
    """One robot's messages on plain keys, on rmw_zenoh's, or on both."""

    def __init__(self, settings: Ros2Settings, robot: str, instance: bytes) -> None:
        """``instance``: up to 64 random bytes that tell this run from others. Raises ValueError
        when the robot's name makes no namespace and none is given."""
        self._settings = settings
        namespace = settings.namespace_of(robot)
        self._graph = Graph(
            domain=settings.domain, namespace=namespace, type_hashes=settings.type_hashes
        )
        self._published = [t for t in PUBLISHED if t is not _ODOM or settings.odom_frame]
        self._plain_start = f"{namespace}/" if namespace else ""
        self._keys = {topic: self._keys_of(topic) for topic in self._published}
        self._gids = {
            topic: gid(self._graph.topic_key(topic), instance) for topic in self._published
        }
        self.outlets: Sequence[Outlet] = [
            Outlet(
                key=key,
                encoding=topic.type.encoding,
                lane=_LANES[topic],
                latched=topic.latched,
            )
            for topic in self._published
            for key in self._keys[topic]
        ]
        self.inlets: Sequence[Inlet] = (
            [
                Inlet(key=key, name="ros2 initialpose", decode=self._initialpose)
                for key in self._keys_of(INITIALPOSE)
            ]
            if settings.initialpose
            else []
        )

    def tokens(self, session_id: str) -> Sequence[str]:
        if not self._settings.rmw_zenoh:
            return ()
        subscribed = [INITIALPOSE] if self._settings.initialpose else []
        return self._graph.tokens(session_id, self._published, subscribed)

    def pose(self, message: PoseMessage) -> Iterable[Encoded]:
        stamp_ns = _ns(message.stamp)
        if not messages.fits(stamp_ns):
            return []
        known = self._settings
        encode = partial(self._encoded, seq=message.seq, stamp_ns=stamp_ns)
        encoded: list[Encoded] = []
        if message.state in _KNOWN_PLACE:
            header = messages.Header(stamp_ns=stamp_ns, frame=known.map_frame)
            encoded += encode(_POSE, messages.pose_with_covariance(header, message))
        if known.odom_frame:
            header = messages.Header(stamp_ns=stamp_ns, frame=known.odom_frame)
            sigmas = known.speed_sigma_mps, known.turn_sigma_radps
            encoded += encode(_ODOM, messages.odometry(header, known.base_frame, message, *sigmas))
        if transforms := self._transforms(message, stamp_ns):
            encoded += encode(_TF, messages.transforms(transforms))
        return encoded

    def status(self, message: StatusMessage) -> Iterable[Encoded]:
        stamp_ns = _ns(message.stamp)
        if not messages.fits(stamp_ns):
            return []
        header = messages.Header(stamp_ns=stamp_ns, frame="")
        payload = messages.diagnostics(header, message)
        return self._encoded(_DIAGNOSTICS, payload, seq=message.seq, stamp_ns=stamp_ns)

    def scan(self, message: ScanMessage) -> Iterable[Encoded]:
        stamp_ns = _ns(message.stamp)
        if not messages.fits(stamp_ns):
            return []
        header = messages.Header(stamp_ns=stamp_ns, frame=self._settings.map_frame)
        payload = messages.points(header, message)
        return self._encoded(_POINTS, payload, seq=message.seq, stamp_ns=stamp_ns)

    def map(self, picture: MapPicture) -> Iterable[Encoded]:
        stamp_ns = _ns(picture.stamp)
        if not messages.fits(stamp_ns):
            return []
        header = messages.Header(stamp_ns=stamp_ns, frame=self._settings.map_frame)
        payload = messages.grid(header, picture)
        return self._encoded(_MAP, payload, seq=picture.seq, stamp_ns=stamp_ns)

    def _transforms(self, message: PoseMessage, stamp_ns: int) -> list[messages.Transform]:
        """map -> odom -> base, or map -> base; what is in the map only while that is known."""
        known = self._settings
        map_from_base = Pose2(message.x, message.y, message.theta)
        child, map_from_child = known.base_frame, map_from_base
        found: list[messages.Transform] = []
        if known.odom_frame:
            odom_from_base = Pose2(message.odom.x, message.odom.y, message.odom.theta)
            header = messages.Header(stamp_ns=stamp_ns, frame=known.odom_frame)
            found.append(
                messages.Transform(header=header, child=known.base_frame, pose=odom_from_base)
            )
            child, map_from_child = known.odom_frame, map_from_base @ odom_from_base.inverse()
        if message.state in _KNOWN_PLACE:
            header = messages.Header(stamp_ns=stamp_ns, frame=known.map_frame)
            found.append(messages.Transform(header=header, child=child, pose=map_from_child))
        return found

    def _encoded(self, topic: Topic, payload: bytes, *, seq: int, stamp_ns: int) -> list[Encoded]:
        beside = attachment(seq, stamp_ns, self._gids[topic])
        return [Encoded(key=k, payload=payload, attachment=beside) for k in self._keys[topic]]

    def _keys_of(self, topic: Topic) -> list[str]:
        plain = [f"{self._plain_start}{topic.name}"] if self._settings.plain else []
        return plain + ([self._graph.topic_key(topic)] if self._settings.rmw_zenoh else [])

    def _initialpose(self, payload: bytes) -> Request:
        return Request(command=read_initialpose(payload, self._settings.map_frame))


def _ns(stamp_s: float) -> int:
    return round(1e9 * stamp_s)
