"""How a robot takes part in the Zenoh network."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from annotated_types import Interval, Len
from pydantic import AfterValidator

from amr_slam.wire.messages import MAX_SCAN_POINTS

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Where a robot listens and a tool on the same machine looks, unless told otherwise."""


def _prefix(prefix: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", prefix):
        raise ValueError("should be names of letters, digits, '_', '-' or '.', joined by '/'")
    return prefix


def _endpoint(endpoint: str) -> str:
    if not re.fullmatch(r"[a-z][a-z0-9-]*/[!-~]+", endpoint):
        raise ValueError(f"should be PROTOCOL/ADDRESS, such as {DEFAULT_ENDPOINT}")
    return endpoint


Endpoint = Annotated[str, AfterValidator(_endpoint)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohSettings:
    """How a robot takes part in the Zenoh network."""

    prefix: Annotated[str, Len(1, 128), AfterValidator(_prefix)] = "amr"
    """First part of every key: ``<prefix>/<robot>/pose``. One per fleet."""
    listen: Annotated[tuple[Endpoint, ...], Len(0, 16)] = (DEFAULT_ENDPOINT,)
    """Endpoints that accept connections, as ``tcp/ADDRESS:PORT``. Loopback unless opened up: who
    can connect can read the poses and, without access control, send commands."""
    connect: Annotated[tuple[Endpoint, ...], Len(0, 16)] = ()
    """Routers to connect to. Absent ones are tried for ever in the background."""
    keys: Path | None = None
    """Folder that ``amr-slam keys robot`` wrote: who the robot is, and whom it trusts. Without it
    nothing is encrypted, and whoever reaches an endpoint is let in."""
    multicast_scouting: bool = False
    """Find each other by multicast: handy on a desk, noise on a vehicle network."""
    scan_points: Annotated[int, Interval(ge=0, le=MAX_SCAN_POINTS)] = 360
    """Points of each registered scan that go out under ``scan``, evenly over what was seen; 0
    publishes no scans."""
    fleet_every: Annotated[int, Interval(ge=0, le=1000)] = 10
    """Every n-th pose goes out under ``fleet_pose``, too, for controllers of many robots: 5 of 50 a
    second. 0: none."""
    lease_ms: Annotated[int, Interval(ge=100, le=1000)] = 1000
    """A frozen robot's ``alive`` token falls after this time in ms; at most 1 s (contract)."""
