"""``amr-slam foxglove`` between a robot on Zenoh and a client of Foxglove's WebSocket protocol."""

from __future__ import annotations

import base64
import json
import queue
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest
from foxglove_official import check
from messages import MAP_ID, pose_of, status_of
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from amr_slam import foxglove
from amr_slam.client import SessionError
from amr_slam.map.export import FREE, OCCUPIED, UNKNOWN, OccupancyImage, png_bytes
from amr_slam.publishing import RobotPublisher
from amr_slam.serving import Asked, ImageWanted, Picture
from amr_slam.watching.foxglove_live import serve
from amr_slam.watching.maps import MapPictures, pictured
from amr_slam.wire import MapImage, ScanMessage, ZenohSettings

if TYPE_CHECKING:
    import zenoh

DEADLINE_S = 60.0
PIXELS = np.full((3, 4), UNKNOWN, dtype=np.uint8)
PIXELS[0] = OCCUPIED  # a wall along the top
PIXELS[1, 1] = FREE
PNG = png_bytes(OccupancyImage(pixels=PIXELS, resolution_m=0.5, x_min_m=-1.0, y_min_m=-2.0))
WHERE = MapImage(
    map=MAP_ID,
    width_px=4,
    height_px=3,
    metres_per_px=0.5,
    column_of_x0_px=2.0,
    row_of_y0_px=-1.0,
)


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def loop(asked: Asked) -> None:
    assert isinstance(asked.request, ImageWanted)
    asked.done(Picture(png=PNG, georeference=WHERE))


@contextmanager
def robot(endpoint: str) -> Iterator[threading.Event]:
    """A robot in the map ``hall``; it says nothing any more once the event is set."""
    silent, stop = threading.Event(), threading.Event()
    with RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as publisher:
        publisher.serve(loop)
        points = ((1.0, 2.0), (3.0, -4.0))

        def publish() -> None:
            seq = 0
            while not stop.wait(0.05):
                if silent.is_set():
                    continue
                publisher.publish_pose(pose_of(seq=10 * seq))
                publisher.publish_status(status_of(seq=seq))
                scan = ScanMessage(
                    robot="amr7", seq=seq, stamp=1.79e9, map=MAP_ID, epoch=2, points=points
                )
                publisher.publish_scan(scan)
                seq += 1

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield silent
        finally:
            stop.set()
            thread.join()


@contextmanager
def serving(endpoint: str) -> Iterator[int]:
    """The port of a live server."""
    stop, ports = threading.Event(), []
    ready = threading.Event()

    def on_ready(port: int) -> None:
        ports.append(port)
        ready.set()

    thread = threading.Thread(
        target=serve, args=(endpoint,), kwargs={"port": 0, "stop": stop, "on_ready": on_ready}
    )
    thread.start()
    try:
        assert ready.wait(DEADLINE_S)
        yield ports[0]
    finally:
        stop.set()
        thread.join()


class Watcher:
    """Subscribes to all that is advertised."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._topics: dict[int, tuple[str, str]] = {}

    def next(self) -> tuple[str, dict[str, Any]]:
        """Topic and content of the next message, valid by Foxglove's schema and its channel's."""
        while True:
            received = self._connection.recv(timeout=DEADLINE_S)
            if isinstance(received, bytes):
                opcode, subscription, _ = struct.unpack_from("<BIQ", received)
                assert opcode == 1
                topic, schema = self._topics[subscription]
                fields = json.loads(received[13:])
                if schema.startswith("foxglove."):
                    check(schema, fields)
                return topic, fields
            told = json.loads(received)
            assert told["op"] in {"serverInfo", "advertise"}, told
            for channel in told.get("channels", []):
                assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
                assert json.loads(channel["schema"])["title"] == channel["schemaName"]
                self._topics[channel["id"]] = channel["topic"], channel["schemaName"]
                wanted = {"id": channel["id"], "channelId": channel["id"]}
                self._connection.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))

    def until(self, *topics: str) -> dict[str, dict[str, Any]]:
        """The newest of each, once all have come."""
        found: dict[str, dict[str, Any]] = {}
        while not set(topics) <= found.keys():
            topic, fields = self.next()
            found[topic] = fields
        return found


@contextmanager
def watching(port: int) -> Iterator[Watcher]:
    protocol = Subprotocol("foxglove.sdk.v1")
    # No pings: a machine that is busy with other tests may be late with its answers.
    with connect(
        f"ws://127.0.0.1:{port}", subprotocols=[protocol], ping_interval=None
    ) as connection:
        yield Watcher(connection)


def test_a_client_sees_robot_scan_health_and_map_however_late_it_comes() -> None:
    endpoint = free_endpoint()
    with robot(endpoint) as silent, serving(endpoint) as port:
        for _ in range(2):
            with watching(port) as watcher:
                found = watcher.until(
                    *(
                        f"/amr7/{leaf}"
                        for leaf in ("tf", "scene", "scan", "health", "pose", "status")
                    ),
                    "/map/hall",
                )
                (moved,) = found["/amr7/tf"]["transforms"]
                assert (moved["parent_frame_id"], moved["child_frame_id"]) == ("hall", "amr7/base")
                assert (moved["translation"]["x"], moved["translation"]["y"]) == (1.5, -2.25)
                points = base64.b64decode(found["/amr7/scan"]["data"])
                assert np.frombuffer(points, "<f4").tolist() == [1.0, 2.0, 0.0, 3.0, -4.0, 0.0]
                assert found["/amr7/scan"]["frame_id"] == "hall"
                assert found["/amr7/health"]["message"] == "state: localized"
                (drawn,) = found["/amr7/scene"]["entities"]
                assert drawn["texts"][0]["text"] == "amr7: localized ± 0.05 m"
                shown = found["/map/hall"]
                cells = np.frombuffer(base64.b64decode(shown["data"]), np.uint8).reshape(3, 4, 4)
                assert (shown["column_count"], shown["cell_size"]["x"]) == (4, 0.5)
                corner = shown["pose"]["position"]
                assert (corner["x"], corner["y"]) == (-1.0, -2.0)
                # Rows of a grid begin at the bottom: the wall along the top is the last one.
                assert (cells[2] == [0, 0, 0, 255]).all()
                assert cells[0, :, 3].tolist() == [0, 0, 0, 0]
                assert cells[1, 1, 3] > 0
        with watching(port) as watcher:
            watcher.until("/amr7/scene")
            silent.set()
            while True:
                topic, fields = watcher.next()
                if topic == "/amr7/scene" and "no pose" in json.dumps(fields):
                    break


def test_large_pictures_become_coarser_and_keep_their_walls() -> None:
    pixels = np.full((2001, 3000), FREE, dtype=np.uint8)
    pixels[1000, :] = OCCUPIED
    image = OccupancyImage(pixels=pixels, resolution_m=0.05, x_min_m=0.0, y_min_m=0.0)
    where = MapImage(
        map=MAP_ID,
        width_px=3000,
        height_px=2001,
        metres_per_px=0.05,
        column_of_x0_px=0.0,
        row_of_y0_px=2001.0,
    )
    shown = pictured("hall", png_bytes(image), where)
    drawn = foxglove.grid(
        0, "hall", shown.pixels, where.metres_per_px, where.column_of_x0_px, where.row_of_y0_px
    )
    cells = np.frombuffer(base64.b64decode(drawn["data"]), np.uint8)
    cells = cells.reshape(-1, drawn["column_count"], 4)
    assert cells[..., 0].size < 510_000
    (row,) = np.flatnonzero((cells == [0, 0, 0, 255]).all(axis=(1, 2)))
    cell_m = drawn["cell_size"]["y"]
    y_m = drawn["pose"]["position"]["y"] + (row + 0.5) * cell_m
    assert y_m == pytest.approx((2001 - 1000.5) * 0.05, abs=cell_m)
    with pytest.raises(ValueError, match="not as it says"):
        pictured("hall", PNG, where)


def test_a_map_is_fetched_once_and_one_that_grows_now_and_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: queue.SimpleQueue[str] = queue.SimpleQueue()

    def answer(_session: object, _prefix: str, name: str, _timeout_s: float) -> Any:
        asked.put(name)
        return PNG, WHERE

    monkeypatch.setattr("amr_slam.watching.maps.ask_map_image", answer)
    pictures = MapPictures(cast("zenoh.Session", None), "amr")
    for name, frame, now_s, grows in (
        ("a1", "hall", 0.0, False),
        ("a2", "hall", 100.0, False),  # the same map, on another robot
        ("b1", "depot", 100.0, True),
        ("b2", "depot", 129.0, True),
        ("b3", "depot", 131.0, True),
    ):
        pictures.want(name, frame, MAP_ID, now_s, grows=grows)
    assert [asked.get(timeout=DEADLINE_S) for _ in range(3)] == ["a1", "b1", "b3"]
    assert asked.empty()


def test_nobody_at_the_endpoint_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("amr_slam.watching.foxglove_live._CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(SessionError):
        serve(free_endpoint(), port=0)


def test_a_port_that_is_taken_is_an_error() -> None:
    endpoint = free_endpoint()
    with robot(endpoint), socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(OSError, match="cannot listen"):
            serve(endpoint, port=taken.getsockname()[1])
