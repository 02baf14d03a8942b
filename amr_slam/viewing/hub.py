"""What all pages show, kept up to date ten times a second from one Zenoh session."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import zenoh

from amr_slam.client import FleetListener, RobotView, SessionError
from amr_slam.viewing.history import History
from amr_slam.viewing.settings import ViewSettings
from amr_slam.watching.rows import Rates, Row
from amr_slam.wire import UNKNOWN, ScanMessage, StatusMessage

_log = logging.getLogger(__name__)

TICK_S: Final = 0.1
_CONNECT_S: Final = 2.0
_AGAIN_S: Final = 1.0
_LINK_S: Final = 0.3
MAX_SCANS: Final = 12
"""Robots whose scans a page shows at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """Whether somebody is there on the other side of the Zenoh session."""

    up: bool
    text: str


class Hub:
    """One listener for all pages. Used in one event loop; :meth:`run` keeps it going."""

    def __init__(self, settings: ViewSettings) -> None:
        self._settings = settings
        self._rates = Rates()
        self._ticked = asyncio.Condition()
        self._following: dict[str, zenoh.Subscriber[None]] = {}
        self._wanted: Counter[str] = Counter()
        self._told: dict[str, tuple[RobotView, str, float | None]] = {}
        self.listener: FleetListener | None = None
        self.history = History()
        self.link = Link(up=False, text=f"connecting to {settings.endpoint}")
        self.robots: dict[str, str] = {}
        """By name: the JSON that pages are sent; a new string whenever there is something new."""

    def views(self) -> Mapping[str, RobotView]:
        return {} if self.listener is None else self.listener.views()

    async def run(self) -> None:
        """Until cancelled. Ticks also while nobody answers: a page that hears none is blind."""
        opening = asyncio.create_task(self._open())
        looked_s = -math.inf
        try:
            while True:
                now_s = time.monotonic()
                if self.listener is not None:
                    if now_s - looked_s >= _LINK_S:
                        looked_s = now_s
                        self._look_at_link(self.listener)
                    self._tick(self._rates.rows(self.listener.views(), "name", now_s))
                elif opening.done():
                    opening.result()  # raises what it has failed with
                async with self._ticked:
                    self._ticked.notify_all()
                await asyncio.sleep(max(0.0, TICK_S - (time.monotonic() - now_s)))
        finally:
            opening.cancel()

    async def next_tick(self) -> None:
        async with self._ticked:
            await self._ticked.wait()

    def close(self) -> None:
        """Idempotent."""
        if self.listener is not None:
            self.listener.close()

    def want_scans(self, robots: Iterable[str]) -> None:
        """One more page wants them."""
        for robot in robots:
            self._wanted[robot] += 1
            if robot not in self._following and self.listener is not None:
                with suppress(SessionError):  # a name that makes no key has no scans
                    self._following[robot] = self.listener.follow_scans(robot)

    def unwant_scans(self, robots: Iterable[str]) -> None:
        for robot in robots:
            self._wanted[robot] -= 1
            if self._wanted[robot] <= 0:
                del self._wanted[robot]
                following = self._following.pop(robot, None)
                if following is not None:
                    with suppress(zenoh.ZError):
                        following.undeclare()  # type: ignore[no-untyped-call]  # as in client

    async def _open(self) -> None:
        """However long nobody answers."""
        settings = self._settings
        while self.listener is None:
            try:
                self.listener = await asyncio.to_thread(
                    FleetListener,
                    settings.endpoint,
                    settings.robots,
                    prefix=settings.prefix,
                    keys=settings.keys,
                    connect_timeout_s=_CONNECT_S,
                    full_rate=settings.full_rate,
                    queue_size=0,
                )
            except SessionError as error:
                self._set_link(Link(up=False, text=str(error)))
                await asyncio.sleep(_AGAIN_S)

    def _look_at_link(self, listener: FleetListener) -> None:
        info = listener.session.info
        up = bool(info.routers_zid() or info.peers_zid())
        endpoint = self._settings.endpoint
        text = f"connected to {endpoint}" if up else f"{endpoint} is gone; trying again"
        self._set_link(Link(up=up, text=text))

    def _set_link(self, link: Link) -> None:
        if link != self.link:
            _log.log(logging.INFO if link.up else logging.WARNING, "%s", link.text)
        self.link = link

    def _tick(self, rows: list[Row]) -> None:
        self.history.record(rows, time.time())
        for row in rows:
            view, before = row.view, self._told.get(row.view.robot)
            if before is None or before[0] is not view or before[1:] != (row.state, row.rate_hz):
                self._told[view.robot] = view, row.state, row.rate_hz
                self.robots[view.robot] = json.dumps(told(row), separators=(",", ":"))


def told(row: Row) -> dict[str, Any]:
    """A robot as pages are told of it, ten times a second at most. ``received_s``: on the server's
    monotonic clock, which each tick tells."""
    view, pose = row.view, row.view.pose
    values: dict[str, Any] = {
        "robot": view.robot,
        "state": row.state,
        "alive": view.alive,
        "rate_hz": row.rate_hz,
        "lost": view.lost,
        "restarts": view.restarts,
        "refused": view.refused,
        "pose": None,
    }
    if pose is not None:
        covariance = pose.covariance
        values["pose"] = {
            "x": pose.x,
            "y": pose.y,
            "theta": pose.theta,
            "vx": pose.vx,
            "omega": pose.omega,
            "xx": covariance[0],
            "xy": covariance[1],
            "yy": covariance[4],
            "tt": covariance[8],
            "error95_m": known(pose.error95_m),
            "since_fix_s": known(pose.since_fix_s),
            "age_s": pose.age_s,
            "received_s": view.pose_received_s,
            "epoch": pose.epoch,
            "map": pose.map,
            "fault": pose.fault,
            "stamp": pose.stamp,
            "seq": pose.seq,
        }
    return values


def told_status(status: StatusMessage) -> dict[str, Any]:
    """What pages show of a status."""
    return status.model_dump(
        mode="json",
        include={
            "robot", "mode", "map", "scanners", "wheels", "slam", "fault", "candidates",
            "explained", "changes", "advice", "version", "uptime_s", "cpu_percent", "memory_mb",
        },
    )  # fmt: skip


def told_scan(scan: ScanMessage) -> dict[str, Any]:
    """A scan for a page: mm are more than it draws."""
    return {
        "robot": scan.robot,
        "map": scan.map,
        "epoch": scan.epoch,
        "points": [[round(x, 2), round(y, 2)] for x, y in scan.points],
    }


def known(value: float) -> float | None:
    """None for "none yet"."""
    return None if value >= UNKNOWN else value
