"""The key expressions that a site's access control is about where its robots speak ROS 2, each in
the namespace of its own name."""

from __future__ import annotations

from dataclasses import dataclass

from amr_slam.encodings.ros2.encoder import INITIALPOSE, PUBLISHED
from amr_slam.encodings.ros2.keys import NODE, Topic


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Keys:
    """Of one robot, or of all."""

    says: tuple[str, ...]
    """What is published: plain keys, and rmw_zenoh's with any hash; and ``keeps``."""
    keeps: tuple[str, ...]
    """Where it answers late subscribers to what is latched."""
    commands: tuple[str, ...]
    """Where initial poses come in."""
    tokens: tuple[str, ...]
    """Its node's liveliness tokens. The first part has an @: ``**`` alone does not match them."""


def ros2_keys(domain: int | None, robot: str | None = None) -> Ros2Keys:
    """``domain`` None: nobody speaks ROS 2, there are none. ``robot`` None: of all robots."""
    if domain is None:
        return Ros2Keys(says=(), keeps=(), commands=(), tokens=())
    name = robot or "*"

    def keys(topic: Topic) -> tuple[str, str]:
        path = f"{name}/{topic.name}"
        return path, f"{domain}/{path}/{topic.type.dds_name}/*"

    latched = [topic for topic in PUBLISHED if topic.latched]
    keeps = tuple(f"{key}/@adv/**" for topic in latched for key in keys(topic))

    # In a chunk, "$*" stands for any part.
    namespace = f"%{robot}" if robot else "%$*"
    return Ros2Keys(
        says=(*(key for topic in PUBLISHED for key in keys(topic)), *keeps),
        keeps=keeps,
        commands=keys(INITIALPOSE),
        tokens=(f"@ros2_lv/{domain}/*/*/*/*/%/{namespace}/{NODE}/**",),
    )
