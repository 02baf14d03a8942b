"""The desks for commands and maps on real sessions; the loop is played by the test."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.publishing import RobotPublisher
from amr_slam.serving import Asked, ImageWanted, MapFile, MapWanted, Picture, desk, maps
from amr_slam.serving.desk import Allowance
from amr_slam.wire import CommandReply, MapImage, Relocalize, SetPose, ZenohSettings

DEADLINE_S = 20.0
MAP_ID = "6f1d6a44-7f0c-4b2c-9df0-0d5b4b4f3c11"


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def asking(endpoint: str) -> Iterator[Callable[..., list[dict[str, Any]]]]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:

        def ask(key: str, payload: bytes | None = None) -> list[dict[str, Any]]:
            replies = session.get(f"amr/amr7/{key}", payload=payload, timeout=DEADLINE_S)
            return [
                json.loads((reply.ok or reply.err).payload.to_bytes())  # type: ignore[union-attr]
                for reply in replies
            ]

        yield ask


@contextmanager
def robot(endpoint: str, loop: Callable[[Asked], object]) -> Iterator[RobotPublisher]:
    with RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as publisher:
        publisher.serve(loop)
        yield publisher


def test_a_command_reaches_the_loop_checked_and_its_reply_comes_back(endpoint: str) -> None:
    seen: list[Asked] = []

    def loop(asked: Asked) -> None:
        seen.append(asked)
        if isinstance(asked.request, SetPose):
            asked.not_done("nothing fits")
        else:
            asked.done(CommandReply(ok=True, file="a.mcap"))

    with robot(endpoint, loop), asking(endpoint) as ask:
        (told,) = ask("cmd/relocalize")
        assert (told["ok"], told["error"], told["file"]) == (True, None, "a.mcap")
        (told,) = ask("cmd/set_pose", b'{"x": 1, "y": -2.5, "theta": 0.5, "radius": 2}')
        assert (told["ok"], told["error"]) == (False, "set_pose: nothing fits")
    assert [one.request for one in seen] == [
        Relocalize(),
        SetPose(x=1.0, y=-2.5, theta=0.5, radius=2.0),
    ]
    assert {one.by for one in seen} == {"somebody"}


def test_who_asks_for_all_that_there_is_gets_no_map_and_commands_nothing(endpoint: str) -> None:
    seen: list[Asked] = []
    with robot(endpoint, seen.append), asking(endpoint) as ask:
        assert ask("**") == []
        assert ask("*/*", b"{}") == []
        (told,) = ask("cmd/*", b"{}")
        assert "one robot, by its full key" in told["error"]
    assert not seen


def test_a_loop_that_does_not_answer_costs_a_command_its_time_only(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk, "ANSWER_LIMIT_S", 0.3)
    seen: list[Asked] = []
    with robot(endpoint, seen.append), asking(endpoint) as ask:
        (told,) = ask("cmd/relocalize")
        assert not told["ok"]
        assert "not done within 0.3 s" in told["error"]
        assert seen[0].answer.cancelled()
        seen[0].done(CommandReply(ok=True))  # too late: nobody is told, nothing breaks
        (told,) = ask("cmd/relocalize")
        assert "not done" in told["error"]
    assert len(seen) == 2


def test_while_one_command_is_under_way_others_are_refused(endpoint: str) -> None:
    seen: list[Asked] = []
    came, told = threading.Event(), []

    def loop(asked: Asked) -> None:
        seen.append(asked)
        came.set()

    with robot(endpoint, loop), asking(endpoint) as ask:
        first = threading.Thread(target=lambda: told.extend(ask("cmd/relocalize")))
        first.start()
        assert came.wait(DEADLINE_S)
        (refused,) = ask("cmd/relocalize")
        assert refused["error"] == "another command is under way"
        seen[0].done(CommandReply(ok=True))
        first.join()
    assert told[0]["ok"]
    assert len(seen) == 1


def test_closing_does_not_wait_for_a_command(endpoint: str) -> None:
    came = threading.Event()
    told: list[dict[str, Any]] = []
    with asking_later(endpoint, told) as start, robot(endpoint, lambda _: came.set()) as publisher:
        start()
        assert came.wait(DEADLINE_S)
        begun_s = time.monotonic()
        publisher.close()
        assert time.monotonic() - begun_s < 5.0
    assert [one["error"] for one in told] == ["relocalize: the robot's program is stopping"]


@contextmanager
def asking_later(endpoint: str, told: list[dict[str, Any]]) -> Iterator[Callable[[], None]]:
    """A controller that asks once it is told to, in a thread."""

    def ask_once() -> None:
        with asking(endpoint) as ask:
            told.extend(ask("cmd/relocalize"))

    thread = threading.Thread(target=ask_once)
    yield thread.start
    thread.join()


def test_maps_and_pictures_come_with_what_they_are(endpoint: str, tmp_path: Path) -> None:
    path = tmp_path / "hall.amrmap"
    map_id = str(save_map(PointMap(MapParams(), "hall"), path))
    georeference = MapImage(
        map=MAP_ID,
        width_px=2,
        height_px=3,
        metres_per_px=0.05,
        column_of_x0_px=1.0,
        row_of_y0_px=2.0,
    )
    wanted: list[object] = []

    def loop(asked: Asked) -> None:
        wanted.append(asked.request)
        if isinstance(asked.request, MapWanted):
            asked.done(MapFile(path=path, map_id=map_id))
        else:
            asked.done(Picture(png=b"png", georeference=georeference))

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with robot(endpoint, loop), zenoh.open(config) as session:
        (reply,) = session.get("amr/amr7/map", timeout=DEADLINE_S)
        assert reply.ok is not None
        assert reply.ok.payload.to_bytes() == path.read_bytes()
        (reply,) = session.get("amr/amr7/map/image?resolution=0.5", timeout=DEADLINE_S)
        assert reply.ok is not None
        assert reply.ok.payload.to_bytes() == b"png"
        assert reply.ok.attachment is not None
        assert json.loads(reply.ok.attachment.to_bytes())["row_of_y0_px"] == 2.0
    assert wanted == [MapWanted(), ImageWanted(resolution_m=0.5)]


@pytest.mark.parametrize("what", ["missing", "large", "replaced", "no map"])
def test_a_map_that_cannot_be_sent_is_an_error_and_not_silence(
    endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    path = tmp_path / "hall.amrmap"
    save_map(PointMap(MapParams(), "hall"), path)
    if what == "missing":
        path.unlink()
    elif what == "large":
        monkeypatch.setattr(maps, "MAX_MAP_BYTES", 10)
    elif what == "no map":
        path.write_bytes(b"something else")

    def loop(asked: Asked) -> None:
        asked.done(MapFile(path=path, map_id=MAP_ID))

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with robot(endpoint, loop), zenoh.open(config) as session:
        (reply,) = session.get("amr/amr7/map", timeout=DEADLINE_S)
    said = {
        "missing": "No such file",
        "large": "larger than",
        "replaced": "has been replaced",
        "no map": "not a map file",
    }
    assert reply.err is not None
    assert said[what] in reply.err.payload.to_string()


@settings(derandomize=True, deadline=None)
@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=100))
def test_in_no_span_of_time_is_more_taken_than_allowed(gaps_s: list[float]) -> None:
    allowance, now_s = Allowance(2.0, 5, 0.0), 0.0
    taken_s = []
    for gap_s in gaps_s:
        now_s += gap_s
        if allowance.takes(now_s):
            taken_s.append(now_s)
    for first, start_s in enumerate(taken_s):
        for last in range(first, len(taken_s)):
            assert last - first + 1 <= 5 + 2.0 * (taken_s[last] - start_s) + 1e-6


def test_who_waits_is_heard_again() -> None:
    allowance = Allowance(2.0, 1, 0.0)
    assert [allowance.takes(t) for t in (0.0, 0.1, 0.6, 0.7)] == [True, False, True, False]


def test_who_tells_the_session_that_asks_is_named(endpoint: str) -> None:
    seen: list[Asked] = []

    def loop(asked: Asked) -> None:
        seen.append(asked)
        asked.done(CommandReply(ok=True))

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with robot(endpoint, loop), zenoh.open(config) as session:
        querier = session.declare_querier("amr/amr7/cmd/relocalize")
        (reply,) = querier.get(source_info=zenoh.SourceInfo(querier.id, 1))
        assert reply.ok is not None
        assert seen[0].by == f"session {session.zid()}"
