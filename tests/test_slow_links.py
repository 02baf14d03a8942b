"""A robot behind a link that takes seconds for a map: poses overtake it, the loop never waits."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
import zenoh
from messages import pose_of, status_of
from test_publishing import free_endpoint, repeat_until, session

from amr_drivers.emulators.slow_link import SlowLink
from amr_slam.client import FleetListener
from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.publishing import RobotPublisher
from amr_slam.sender import Sender
from amr_slam.serving import Asked, MapFile, maps
from amr_slam.wire import ZenohSettings

DEADLINE_S = 60.0
BITS_PER_S = 4e6
MAP_BYTES = 1_500_000
"""Three seconds of that link."""


class Driving:
    """A robot that publishes at 50 Hz and gives a large map, for as long as ``with`` lasts."""

    def __init__(self, endpoint: str, path: Path, map_id: str) -> None:
        self.longest_s = 0.0
        """Of a turn of its loop."""
        self._robot = RobotPublisher(ZenohSettings(listen=(), connect=(endpoint,)), "amr7")

        def answer(asked: Asked) -> None:
            asked.done(MapFile(path=path, map_id=map_id))

        self._robot.serve(answer)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def _drive(self) -> None:
        seq = 0
        while not self._stop.wait(0.02):
            begun_s = time.monotonic()
            self._robot.publish_pose(pose_of(seq=seq))
            self._robot.publish_status(status_of(seq=seq))
            self.longest_s = max(self.longest_s, time.monotonic() - begun_s)
            seq += 1

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._robot.close()


@contextmanager
def rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Driving, FleetListener, zenoh.Session]]:
    """A robot behind a slow link to its router; a listener and somebody who asks, at the router."""
    path = tmp_path / "hall.amrmap"
    map_id = str(save_map(PointMap(MapParams(), "hall"), path))
    monkeypatch.setattr(maps, "_read", lambda _: bytes(MAP_BYTES))  # only its size counts here
    endpoint = free_endpoint()
    with session("router", listen=[endpoint]), SlowLink(endpoint, BITS_PER_S) as link:
        driving = Driving(link.endpoint, path, map_id)
        try:
            with (
                FleetListener(endpoint, ["amr7"]) as fleet,
                session("client", connect=[endpoint]) as asker,
            ):
                assert fleet.wait_for(
                    lambda views: views["amr7"].alive and views["amr7"].poses > 10, DEADLINE_S
                )
                yield driving, fleet, asker
        finally:
            driving.close()


def test_poses_overtake_a_map_on_a_slow_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with rig(tmp_path, monkeypatch) as (driving, fleet, asker):
        driving.longest_s = 0.0
        before = fleet.views()["amr7"]
        (reply,) = asker.get("amr/amr7/map", timeout=DEADLINE_S, priority=zenoh.Priority.DATA_LOW)
        meanwhile = fleet.views()["amr7"]
        assert reply.ok is not None
        assert len(reply.ok.payload) == MAP_BYTES
        # 150 are made in that time; behind the map there would be none before its end.
        assert meanwhile.poses - before.poses >= 50
        assert meanwhile.alive
        assert driving.longest_s < 1.0


@pytest.mark.parametrize("priority", [zenoh.Priority.REAL_TIME, zenoh.Priority.INTERACTIVE_LOW])
def test_who_asks_for_a_map_at_the_poses_priority_does_not_stop_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, priority: zenoh.Priority
) -> None:
    with rig(tmp_path, monkeypatch) as (driving, fleet, asker):
        driving.longest_s = 0.0
        (reply,) = asker.get("amr/amr7/map", timeout=DEADLINE_S, priority=priority)
        assert reply.ok is not None
        assert driving.longest_s < 1.0  # the map takes three seconds
        newest = fleet.views()["amr7"].poses
        assert fleet.wait_for(lambda views: views["amr7"].poses > newest + 30, DEADLINE_S)


def test_of_what_waits_too_long_the_oldest_go() -> None:
    entered, go_on = threading.Event(), threading.Event()
    put: list[bytes] = []

    def slow(payload: bytes) -> None:  # what a publisher does on a link that hangs
        entered.set()
        assert go_on.wait(DEADLINE_S)
        put.append(payload)

    sender = Sender("test", places=3)
    sender.send(partial(slow, b"0"))
    assert entered.wait(DEADLINE_S)
    for n in range(1, 10):
        sender.send(partial(slow, b"%d" % n))
    go_on.set()
    sender.close()
    assert put == [b"0", b"7", b"8", b"9"]


def test_a_sender_that_cannot_put_says_so_at_the_next_one() -> None:
    endpoint = free_endpoint()
    with session("peer", listen=[endpoint]) as opened:
        publisher = opened.declare_publisher("amr/amr7/pose")
    sender = Sender("poses", places=3)

    def put() -> None:
        sender.send(partial(publisher.put, b"x"))

    with pytest.raises(zenoh.ZError):  # the session is closed
        repeat_until(put, lambda: False)
    sender.close()
    sender.close()


def test_a_robot_that_is_opened_in_vain_leaves_no_thread() -> None:
    before = set(threading.enumerate())
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(Exception, match="in use"):
            RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7")
    assert set(threading.enumerate()) == before
