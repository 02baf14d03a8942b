"""Zenoh's access control for a site: what a router lets through from whom to whom, and how much
of it. Pure.

A message is *ingress* where the router receives it, *egress* where it sends it on. What no rule
allows is dropped without an answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Rules = dict[str, Any]

# What controllers may read by ``get``; commands are not among it.
_READABLE = ("pose", "fleet_pose", "status", "scan", "map", "map/**")
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
) -> Rules:
    """The router's ``access_control``.

    ``robots``, ``commanders`` (may call commands) and ``watchers`` (may only look) are names of
    members; ``by``: ``cert_common_names`` (TLS) or ``usernames`` (passwords).
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
        says = allow(
            f"{robot} says",
            ("put", "delete", "declare_queryable", "reply", "liveliness_token"),
            "ingress",
            (own,),
        )
        hears = allow(f"{robot} is asked", ("query",), "egress", (own,))
        # A publisher sends nothing before it knows of a subscriber, and `amr/**` does not lie
        # within `amr/amr7/**`: of subscriptions a robot hears all.
        learns = allow(
            f"{robot} learns of listeners",
            ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
            "egress",
            ("**",),
        )
        let(robot, (member(robot=robot),), (says, hears, learns))
    listens = allow(
        "controllers listen",
        ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
        "ingress",
        (f"{prefix}/**",),
    )
    asks = allow(
        "controllers ask", ("query",), "ingress", [f"{prefix}/*/{leaf}" for leaf in _READABLE]
    )
    hear = allow(
        "controllers hear",
        ("put", "delete", "reply", "liveliness_token", "declare_queryable"),
        "egress",
        (f"{prefix}/**",),
    )
    command = allow("controllers command", ("query",), "ingress", (f"{prefix}/*/cmd/*",))
    if commanders:
        names = [member(controller=name) for name in commanders]
        let("commanders", names, (listens, asks, hear, command))
    if watchers:
        let("watchers", [member(controller=name) for name in watchers], (listens, asks, hear))
    if by == "cert_common_names":
        # A router of the site has judged by the same rules what it passes on.
        passes = allow("routers pass on", _ALL, "ingress", ("**",))
        takes = allow("routers take", _ALL, "egress", ("**",))
        let("routers", (ROUTER,), (passes, takes))
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def size_limits(prefix: str, max_bytes: int) -> list[Rules]:
    """The router's ``low_pass_filter``: whatever is larger goes no further. Only maps and their
    pictures may be."""
    return [
        {
            "id": "messages and arguments",
            "messages": ["put", "delete", "query"],
            "flows": ["ingress"],
            "key_exprs": ["**"],
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


def member(*, robot: str | None = None, controller: str | None = None) -> str:
    """The common name or user name of a robot or a controller: never each other's."""
    return f"robot-{robot}" if robot is not None else f"fleet-{controller}"
