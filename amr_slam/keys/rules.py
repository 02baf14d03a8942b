"""Zenoh's access control for a site: what a router lets through from whom to whom, and how much
of it. Pure.

A message is *ingress* where the router receives it, *egress* where it sends it on. What no rule
allows is dropped without an answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

from amr_slam.encodings.ros2 import ros2_keys
from amr_slam.encodings.vda5050 import vda5050_keys

Rules = dict[str, Any]
Kind = Literal["robot", "fleet", "camera"]
"""Of members: a fleet's are its controllers."""

# What controllers may read by ``get``; commands are not among it.
_READABLE = ("pose", "fleet_pose", "status", "scan", "map", "map/**", "vda5050/**")
ROUTER = "router"
"""Common name of the routers of a site; members' begin otherwise."""
_ALL = (
    "put", "delete", "query", "reply", "declare_subscriber", "declare_queryable",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
)  # fmt: skip
_SMALL = ("pose", "fleet_pose", "status", "scan", "cmd/*")


def access_control(
    prefix: str,
    robots: Sequence[str],
    commanders: Sequence[str],
    watchers: Sequence[str],
    *,
    by: str,
    ros2_domain: int | None = None,
    vda5050: str | None = None,
    cameras: Mapping[str, str] = MappingProxyType({}),
) -> Rules:
    """The router's ``access_control``.

    ``robots``, ``commanders`` (may call commands) and ``watchers`` (may only look) are names of
    members; ``by``: ``cert_common_names`` (TLS) or ``usernames`` (passwords). With
    ``ros2_domain``, robots also speak ROS 2 in it, each in the namespace of its name; with
    ``vda5050``, the first level of that standard's topics, each under its name as serial number.
    Initial poses and instant actions are commands, as what is under ``cmd/``. ``cameras``: systems
    whose poses robots compare with their own (shadow mode), by name, and each one's key expression.
    """
    rules: list[Rules] = []
    policies: list[Rules] = []
    subjects: list[Rules] = []

    def allow(name: str, messages: Sequence[str], flow: str, keys: Sequence[str]) -> str:
        rules.append(
            {
                "id": name,
                "messages": list(messages),
                "flows": [flow],
                "permission": "allow",
                "key_exprs": list(keys),
            }
        )
        return name

    def let(who: str, members: Sequence[str], what: Sequence[str]) -> None:
        subjects.append({"id": who, by: list(members)})
        policies.append({"rules": list(what), "subjects": [who]})

    for robot in robots:
        own = f"{prefix}/{robot}/**"
        ros2, vda = ros2_keys(ros2_domain, robot), vda5050_keys(vda5050, robot)
        says = allow(
            f"{robot} says",
            ("put", "delete", "declare_queryable", "reply", "liveliness_token"),
            "ingress",
            (own, *ros2.says, *ros2.tokens, *vda.says),
        )
        hears = allow(f"{robot} is asked", ("query",), "egress", (own, *ros2.keeps))
        takes: list[str] = []
        if told := (*ros2.commands, *vda.commands, *cameras.values()):
            takes += [
                allow(f"{robot} listens", ("declare_subscriber",), "ingress", told),
                allow(f"{robot} is told", ("put",), "egress", told),
            ]
        # A publisher sends nothing before it knows of a subscriber, and `amr/**` does not lie
        # within `amr/amr7/**`: of subscriptions a robot hears all.
        learns = allow(
            f"{robot} learns of listeners",
            ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
            "egress",
            ("**", *_graph(ros2_domain)),
        )
        let(robot, (member("robot", robot),), (says, hears, learns, *takes))
    ros2, vda = ros2_keys(ros2_domain), vda5050_keys(vda5050)
    # A fleet control of VDA 5050 looks at all that its vehicles say there.
    topics = () if vda5050 is None else (f"{vda5050}/**",)
    listens = allow(
        "controllers listen",
        ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
        "ingress",
        (f"{prefix}/**", *ros2.says, *_graph(ros2_domain), *topics),
    )
    asks = allow(
        "controllers ask",
        ("query",),
        "ingress",
        [*(f"{prefix}/*/{leaf}" for leaf in _READABLE), *ros2.keeps],
    )
    hear = allow(
        "controllers hear",
        ("put", "delete", "reply", "liveliness_token", "declare_queryable"),
        "egress",
        (f"{prefix}/**", *ros2.says, *ros2.tokens, *topics),
    )
    command = [allow("controllers command", ("query",), "ingress", (f"{prefix}/*/cmd/*",))]
    if told := (*ros2.commands, *vda.commands):
        command += [
            allow("controllers tell robots", ("put",), "ingress", told),
            allow("controllers find robots", ("declare_subscriber",), "egress", told),
        ]
    if commanders:
        names = [member("fleet", name) for name in commanders]
        let("commanders", names, (listens, asks, hear, *command))
    if watchers:
        let("watchers", [member("fleet", name) for name in watchers], (listens, asks, hear))
    for name, key in cameras.items():
        sees = allow(f"camera {name} says", ("put",), "ingress", (key,))
        finds = allow(
            f"camera {name} learns of listeners", ("declare_subscriber",), "egress", (key,)
        )
        let(f"camera {name}", (member("camera", name),), (sees, finds))
    if by == "cert_common_names":
        # A router of the site has judged by the same rules what it passes on.
        passes = allow("routers pass on", _ALL, "ingress", ("**",))
        gets = allow("routers take", _ALL, "egress", ("**",))
        let("routers", (ROUTER,), (passes, gets))
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _graph(ros2_domain: int | None) -> tuple[str, ...]:
    """What rmw_zenoh asks for: the whole graph of a domain, of which it is told the robots."""
    return () if ros2_domain is None else (f"@ros2_lv/{ros2_domain}/**",)


def size_limits(prefix: str, max_bytes: int, *, ros2: bool = False) -> list[Rules]:
    """The router's ``low_pass_filter``: whatever is larger goes no further. Only maps and their
    pictures may be; ``ros2``: those that robots put on ROS 2's keys as well."""
    return [
        {
            "id": "messages and arguments",
            "messages": ["put", "delete", "query"],
            "flows": ["ingress"],
            "key_exprs": [f"{prefix}/**"] if ros2 else ["**"],
            "size_limit": max_bytes,
        },
        {
            "id": "replies",
            "messages": ["reply"],
            "flows": ["ingress"],
            "key_exprs": [f"{prefix}/*/{leaf}" for leaf in _SMALL],
            "size_limit": max_bytes,
        },
    ]


def member(kind: Kind, name: str) -> str:
    """The common name or user name of a member: those of one kind are never another's."""
    return f"{kind}-{name}"
