"""``amr-slam foxglove``: the robots on Zenoh, live in Foxglove.

A server for Foxglove's WebSocket protocol on this computer alone; it can only be looked at. What
nobody has subscribed to is not put together.
"""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import foxglove as sdk  # an extra of the installation
import numpy as np
from foxglove.websocket import ChannelView, Client, ServerListener

from amr_slam import foxglove
from amr_slam.client import FleetListener, RobotView
from amr_slam.recording.messages import PUBLISHED_SCHEMAS
from amr_slam.recording.messages import SCHEMAS as RECORDED_SCHEMAS
from amr_slam.watching.maps import MapPictures
from amr_slam.wire import PoseMessage, StatusMessage

_CONNECT_TIMEOUT_S: Final = 5.0
_PERIOD_S: Final = 0.1
_STALE_S: Final = 0.5
"""The same as for those who drive by the poses."""
_HOST: Final = "127.0.0.1"
_SCHEMAS: Final = foxglove.SCHEMAS | RECORDED_SCHEMAS


def serve(
    endpoint: str,
    robots: Sequence[str] = (),
    *,
    prefix: str = "amr",
    keys: Path | None = None,
    port: int,
    stop: threading.Event | None = None,
    on_ready: Callable[[int], object] = lambda _: None,
) -> None:
    """Serve the robots on this computer's ``port`` (0: any that is free) until Ctrl-C or ``stop``.

    ``on_ready`` is called with the port once clients can come. Raises SessionError when nobody
    answers at ``endpoint``, OSError where the port is taken.
    """
    stop = stop or threading.Event()
    with FleetListener(
        endpoint,
        robots,
        prefix=prefix,
        keys=keys,
        connect_timeout_s=_CONNECT_TIMEOUT_S,
        full_rate=False,
    ) as fleet:
        shown = _Shown(fleet, MapPictures(fleet.session, prefix))
        try:
            server = sdk.start_server(
                name="AMR-SLAM", host=_HOST, port=port, server_listener=shown, context=shown.context
            )
        except RuntimeError as error:
            raise OSError(0, f"cannot listen ({error})", f"{_HOST}:{port}") from error
        try:
            on_ready(server.port)
            while not stop.wait(_PERIOD_S):
                shown.turn()
        finally:
            server.stop()


@dataclass(slots=True, kw_only=True, eq=False)
class _Follower:
    """What of one robot has been shown."""

    health: foxglove.Health
    seen: RobotView
    map_frame: str = ""


class _Shown(ServerListener):
    """What clients see. Turns are of one thread, subscriptions come on the server's."""

    def __init__(self, fleet: FleetListener, maps: MapPictures) -> None:
        self.context = sdk.Context()
        self._fleet = fleet
        self._maps = maps
        self._followers: dict[str, _Follower] = {}
        self._channels: dict[str, sdk.Channel] = {}
        self._fresh: queue.SimpleQueue[str] = queue.SimpleQueue()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002 - theirs
        """Who comes late is told what is said but once."""
        self._fresh.put(channel.topic)

    def turn(self) -> None:
        """Show what is new."""
        fresh = set()
        while not self._fresh.empty():
            fresh.add(self._fresh.get())
        now_ns = time.time_ns()
        for name, view in self._fleet.views().items():
            if view.status is not None:
                self._show(name, view, view.status, fresh, now_ns)
        frames = {follower.map_frame for follower in self._followers.values()}
        came = self._maps.take(frames)
        again = (self._maps.of(frame) for frame in frames if f"/map/{frame}" in fresh)
        for one in {*came, *filter(None, again)}:
            at = one.where
            where = (one.pixels, at.metres_per_px, at.column_of_x0_px, at.row_of_y0_px)
            self._log(
                f"/map/{one.frame}", foxglove.GRID, now_ns, foxglove.grid, now_ns, one.frame, *where
            )

    def _show(
        self, name: str, view: RobotView, status: StatusMessage, fresh: set[str], now_ns: int
    ) -> None:
        follower = self._followers.get(name)
        if follower is None:
            self._fleet.follow_scans(name)
            follower = self._followers[name] = _Follower(
                health=foxglove.Health(name), seen=RobotView(robot=name)
            )
        # Robots in one map share its frame; one that has none has a frame of its own.
        follower.map_frame = f"{name}/no map" if status.map is None else status.map.name
        if status.map is not None:
            grows = status.mode == "mapping"
            now_s = time.monotonic()
            self._maps.want(name, follower.map_frame, status.map.id, now_s, grows=grows)
        robot = foxglove.Robot(name=name, base_frame=f"{name}/base", map_frame=follower.map_frame)
        if f"/{name}/health" in fresh:
            follower.health = foxglove.Health(name)
        if status is not follower.seen.status or f"/{name}/health" in fresh:
            self._show_status(robot, follower.health, status, now_ns)
        if view.pose is not None:
            self._show_pose(robot, follower.seen.pose, view, view.pose, now_ns)
        if view.scan is not None and view.scan is not follower.seen.scan:
            points_m = np.array(view.scan.points, dtype=np.float64)
            self._log(
                f"/{name}/scan", foxglove.POINT_CLOUD, now_ns,
                foxglove.points, now_ns, robot.map_frame, points_m,
            )  # fmt: skip
        follower.seen = view

    def _show_status(
        self, robot: foxglove.Robot, health: foxglove.Health, status: StatusMessage, now_ns: int
    ) -> None:
        fields = json.loads(status.encode())
        self._log(f"/{robot.name}/status", PUBLISHED_SCHEMAS["status"], now_ns, dict, fields)
        for line in health.lines(now_ns, fields):
            self._log(f"/{robot.name}/health", foxglove.LOG, now_ns, dict, line)
        if status.candidates:
            self._log(
                f"/{robot.name}/scene", foxglove.SCENE_UPDATE, now_ns,
                robot.candidates, now_ns, fields,
            )  # fmt: skip

    def _show_pose(
        self,
        robot: foxglove.Robot,
        shown: PoseMessage | None,
        view: RobotView,
        pose: PoseMessage,
        now_ns: int,
    ) -> None:
        age_s = view.pose_age_s()
        stale_s = age_s if age_s > _STALE_S or not view.alive else None
        if pose is shown and stale_s is None:
            return
        topic, fields = f"/{robot.name}", json.loads(pose.encode())
        if pose is not shown:
            self._log(f"{topic}/pose", PUBLISHED_SCHEMAS["pose"], now_ns, dict, fields)
            self._log(f"{topic}/tf", foxglove.TRANSFORMS, now_ns, robot.transforms, now_ns, fields)
        self._log(
            f"{topic}/scene", foxglove.SCENE_UPDATE, now_ns, robot.scene, now_ns, fields, stale_s
        )

    def _log(
        self,
        topic: str,
        schema: str,
        now_ns: int,
        made: Callable[..., foxglove.Fields],
        *values: Any,
    ) -> None:
        """``made(*values)`` on a channel, if somebody wants to see it."""
        channel = self._channels.get(topic)
        if channel is None:
            described = sdk.Schema(name=schema, encoding="jsonschema", data=_SCHEMAS[schema])
            channel = self._channels[topic] = sdk.Channel(
                topic, schema=described, message_encoding="json", context=self.context
            )
        if channel.has_sinks():
            channel.log(foxglove.as_bytes(made(*values)), log_time=now_ns)
