"""Where ROS 2 programs look on Zenoh, and what rmw_zenoh wants beside the message.

Plain keys are those of zenoh-bridge-ros2dds: ``<namespace>/<topic>``. rmw_zenoh's hold the domain,
the type and the hash of its definition (REP 2011); each message carries an attachment, and each
node, publisher and subscription holds a liveliness token, or the graph does not know it. Source:
rmw_zenoh's ``liveliness_utils.cpp`` and ``attachment_helpers.cpp``, the form since ROS 2 Jazzy.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

NODE: Final = "amr_slam"
_NO_HASH: Final = "TypeHashNotSupported"
_QOS: Final = "::,10:,:,:,,"
"""Reliable, volatile, the last ten kept, no deadlines: only what is not the default is written."""
_LATCHED: Final = ":1:,1:,:,:,,"
_GID_BYTES: Final = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Type:
    """A message's type."""

    package: str
    name: str
    hash: str
    """Of its definition, which is the same from Humble to Jazzy."""

    @property
    def encoding(self) -> str:
        """Zenoh's, with the type as its schema."""
        return f"application/cdr;{self.package}/msg/{self.name}"

    @property
    def dds_name(self) -> str:
        return f"{self.package}::msg::dds_::{self.name}_"


POSE: Final = Type(
    package="geometry_msgs",
    name="PoseWithCovarianceStamped",
    hash="26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
)
ODOMETRY: Final = Type(
    package="nav_msgs",
    name="Odometry",
    hash="3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
)
TRANSFORMS: Final = Type(
    package="tf2_msgs",
    name="TFMessage",
    hash="e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
)
DIAGNOSTICS: Final = Type(
    package="diagnostic_msgs",
    name="DiagnosticArray",
    hash="5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
)
POINTS: Final = Type(
    package="sensor_msgs",
    name="PointCloud2",
    hash="9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
)
GRID: Final = Type(
    package="nav_msgs",
    name="OccupancyGrid",
    hash="8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of the robot."""

    name: str
    """Without the namespace."""
    type: Type
    latched: bool = False
    """Late subscribers get the newest: transient local, the last one kept."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """One node's place in the ROS graph of rmw_zenoh."""

    domain: int
    namespace: str
    """Empty: none."""
    type_hashes: bool

    def topic_key(self, topic: Topic) -> str:
        """What messages of the topic are published on."""
        path = f"{self.namespace}/{topic.name}" if self.namespace else topic.name
        return f"{self.domain}/{path}/{topic.type.dds_name}/{self._hash(topic.type)}"

    def tokens(
        self, session_id: str, published: Sequence[Topic], subscribed: Sequence[Topic]
    ) -> list[str]:
        """The liveliness tokens of the node, of its publishers and of its subscriptions."""
        namespace = _mangled(f"/{self.namespace}")
        node = f"%/{namespace}/{NODE}"
        start = f"@ros2_lv/{self.domain}/{session_id}/0"
        tokens = [f"{start}/0/NN/{node}"]
        kinds = [("MP", topic) for topic in published] + [("MS", topic) for topic in subscribed]
        for number, (kind, topic) in enumerate(kinds, start=1):
            path = _mangled(f"/{self.namespace}/{topic.name}".replace("//", "/"))
            qos = _LATCHED if topic.latched else _QOS
            what = f"{path}/{topic.type.dds_name}/{self._hash(topic.type)}/{qos}"
            tokens.append(f"{start}/{number}/{kind}/{node}/{what}")
        return tokens

    def _hash(self, kind: Type) -> str:
        return f"RIHS01_{kind.hash}" if self.type_hashes else _NO_HASH


def gid(key: str, instance: bytes) -> bytes:
    """16 bytes that tell this publisher, in this run (``instance``), from all others.

    rmw_zenoh derives its own from the publisher's token and compares those of messages with each
    other, to count what was lost: any that is unique serves.
    """
    return hashlib.blake2b(key.encode(), key=instance, digest_size=_GID_BYTES).digest()


def attachment(seq: int, stamp_ns: int, publisher: bytes) -> bytes:
    """As ``zenoh.ext.z_serialize`` writes (int64, int64, bytes): the message's number, the instant
    it is true for in ns since 1970, and the publisher's :func:`gid`."""
    return struct.pack(f"<qqB{_GID_BYTES}s", seq, stamp_ns, _GID_BYTES, publisher)


def _mangled(name: str) -> str:
    return name.replace("/", "%")
