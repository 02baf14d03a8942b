"""Zenoh's access control for a site: what a router lets through from whom to whom. Pure.

A message is *ingress* where the router receives it, *egress* where it sends it on. What no rule
allows is dropped without an answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Rules = dict[str, Any]

# What controllers may read by ``get``; commands are not among it.
_READABLE = ("pose", "status", "scan", "map", "map/**", "vda5050/**")
# Topics of VDA 5050: who commands a vehicle speaks on these, the robot itself on the other.
_TO_VEHICLE = ("instantActions", "state")
_FROM_VEHICLE = "visualization"


def access_control(
    prefix: str,
    robots: Sequence[str],
    commanders: Sequence[str],
    watchers: Sequence[str],
    *,
    by: str,
    vda5050: str | None = None,
) -> Rules:
    """The router's ``access_control``.

    ``robots``, ``commanders`` (may call commands) and ``watchers`` (may only look) are names of
    members; ``by``: ``cert_common_names`` (TLS) or ``usernames`` (passwords). ``vda5050``: first
    level of that standard's topics, where robots have them; serial numbers are the robots' names.
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

    def topics(vehicle: str, names: Sequence[str]) -> list[str]:
        return [f"{vda5050}/*/*/{vehicle}/{name}" for name in names if vda5050 is not None]

    heard = [f"{prefix}/**", *topics("*", ("**",))]
    for robot in robots:
        own = f"{prefix}/{robot}/**"
        says = allow(
            f"{robot} says",
            ("put", "delete", "declare_queryable", "reply", "liveliness_token"),
            "ingress",
            (own, *topics(robot, (_FROM_VEHICLE,))),
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
        rights = [says, hears, learns]
        if vda5050 is not None:
            told = topics(robot, _TO_VEHICLE)
            rights += [
                allow(f"{robot} listens", ("declare_subscriber",), "ingress", told),
                allow(f"{robot} is told", ("put",), "egress", told),
            ]
        let(robot, (member(robot=robot),), rights)
    listens = allow(
        "controllers listen",
        ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
        "ingress",
        heard,
    )
    asks = allow(
        "controllers ask", ("query",), "ingress", [f"{prefix}/*/{leaf}" for leaf in _READABLE]
    )
    hear = allow(
        "controllers hear",
        ("put", "delete", "reply", "liveliness_token", "declare_queryable"),
        "egress",
        heard,
    )
    commands = [allow("controllers command", ("query",), "ingress", (f"{prefix}/*/cmd/*",))]
    if vda5050 is not None:
        told = topics("*", _TO_VEHICLE)
        commands += [
            allow("controllers tell vehicles", ("put",), "ingress", told),
            allow("controllers learn who listens", ("declare_subscriber",), "egress", told),
        ]
    if commanders:
        names = [member(controller=name) for name in commanders]
        let("commanders", names, (listens, asks, hear, *commands))
    if watchers:
        let("watchers", [member(controller=name) for name in watchers], (listens, asks, hear))
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def member(*, robot: str | None = None, controller: str | None = None) -> str:
    """The common name or user name of a robot or a controller: never each other's."""
    return f"robot-{robot}" if robot is not None else f"fleet-{controller}"
