"""Controllers' view of robots: real sessions on loopback. A robot that freezes is a process."""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import zenoh
from messages import MAP_ID, pose_of, status_of
from paths import REPO
from test_publishing import free_endpoint, robot_process, session

from amr_slam.cli import main
from amr_slam.client import (
    AskingError,
    CommandRefusedError,
    Fleet,
    Robot,
    SessionError,
    StalePoseError,
    ask_map,
    ask_map_image,
    call,
)
from amr_slam.publishing import RobotPublisher
from amr_slam.wire import (
    CommandReply,
    MapImage,
    MapPart,
    Relocalize,
    SaveMap,
    ScanMessage,
    WireError,
    ZenohSettings,
    command_of,
)

DEADLINE_S = 30.0
PATIENT_S = 10.0
IMAGE = MapImage(
    map=MAP_ID,
    width_px=8,
    height_px=6,
    metres_per_px=0.05,
    column_of_x0_px=4.0,
    row_of_y0_px=3.0,
)


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


def run(work: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        await asyncio.wait_for(work(), DEADLINE_S)

    asyncio.run(bounded())


@contextmanager
def driving(endpoint: str, *robots: str) -> Iterator[None]:
    """Robots that publish at 50 Hz meanwhile; the first one listens, the others connect to it."""
    stop = threading.Event()

    def drive(robot: RobotPublisher, name: str) -> None:
        seq = 0
        while not stop.wait(0.02):
            robot.publish_pose(pose_of(name, seq=seq))
            robot.publish_status(status_of(name, seq=seq))
            seq += 1

    with session("router", listen=[endpoint]):
        opened = [
            RobotPublisher(ZenohSettings(listen=(), connect=(endpoint,)), name) for name in robots
        ]
        threads = [
            threading.Thread(target=drive, args=pair) for pair in zip(opened, robots, strict=True)
        ]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            stop.set()
            for thread in threads:
                thread.join()
            for robot in opened:
                robot.close()


@contextmanager
def answering(endpoint: str) -> Iterator[None]:
    """What stands for the daemon's side of commands and maps."""

    def answer(query: zenoh.Query) -> None:
        with query:
            name = str(query.key_expr).rsplit("/", 1)[-1]
            try:
                command = command_of(name, query.payload.to_bytes() if query.payload else b"")
                reply = CommandReply(ok=True)
                if isinstance(command, SaveMap):
                    if command.name == "full":
                        raise OSError("the disk is full")  # noqa: TRY301 - as it would come
                    reply = CommandReply(
                        ok=True, map=MapPart(id=MAP_ID, name=command.name, version=3)
                    )
            except (WireError, OSError) as error:
                reply = CommandReply.refusing(error)
            query.reply(query.key_expr, reply.encode())

    def give_map(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, bytes(3_000_000))

    def give_image(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, b"PNG", attachment=IMAGE.encode())

    def ignore(query: zenoh.Query) -> None:
        with query:
            pass

    with session("peer", listen=[endpoint]) as daemon:
        daemon.declare_queryable("amr/amr7/cmd/*", answer)
        daemon.declare_queryable("amr/amr7/map", give_map)
        daemon.declare_queryable("amr/amr7/map/image", give_image)
        daemon.declare_queryable("amr/amr8/cmd/*", ignore)
        yield


def test_poses_come_newest_first_and_a_slow_program_skips_the_others(endpoint: str) -> None:
    async def work() -> None:
        async with Robot("amr7", endpoint=endpoint) as robot:
            seen = []
            async for pose in robot.poses(PATIENT_S):
                seen.append(pose.seq)
                time.sleep(0.1)
                if len(seen) == 5:
                    break
            assert seen == sorted(set(seen))
            assert seen[-1] - seen[0] > 4  # not the queue of all
            assert robot.pose(PATIENT_S).robot == "amr7"
            assert robot.alive
            while robot.status is None:
                await asyncio.sleep(0.01)
            assert robot.view.lost <= 1

    with driving(endpoint, "amr7"):
        run(work)


def test_a_frozen_robot_raises_staleness_although_no_message_comes(endpoint: str) -> None:
    async def work(pid: int) -> None:
        async with Robot("amr7", endpoint=endpoint) as robot:
            async for _ in robot.poses(PATIENT_S):
                break
            os.kill(pid, signal.SIGSTOP)
            begun_s = time.monotonic()
            with pytest.raises(StalePoseError, match="amr7: no pose for"):
                async for _ in robot.poses(0.4):
                    pass
            assert time.monotonic() - begun_s < 5.0
            with pytest.raises(StalePoseError):
                robot.pose(0.4)

    with robot_process(endpoint) as process:
        run(lambda: work(process.pid))


def test_a_killed_robot_is_gone_before_its_pose_is_old(endpoint: str) -> None:
    async def work(process: subprocess.Popen[str]) -> None:
        async with Robot("amr7", endpoint=endpoint) as robot:

            async def follow() -> None:
                async for _ in robot.poses(1000.0):
                    process.kill()

            with pytest.raises(StalePoseError, match="amr7: gone"):
                await follow()
            with pytest.raises(StalePoseError, match="amr7: gone"):
                robot.pose(1000.0)

    with robot_process(endpoint) as process:
        run(lambda: work(process))


def test_gaps_and_restarts_are_counted(endpoint: str) -> None:
    async def work(other: zenoh.Session) -> None:
        async with Robot("amr7", endpoint=endpoint) as robot:
            publisher = other.declare_publisher("amr/amr7/pose")
            while robot.view.pose is None:
                publisher.put(pose_of(seq=0).encode())
                await asyncio.sleep(0.02)
            before = robot.view
            for seq in (10**6, 10**6 + 1, 10**6 + 4, 5):
                publisher.put(pose_of(seq=seq).encode())
            while robot.view.pose is None or robot.view.pose.seq != 5:
                await asyncio.sleep(0.01)
            assert robot.view.lost - before.lost == 10**6 - 1 + 2
            assert robot.view.restarts >= before.restarts + 1

    with session("peer", listen=[endpoint]) as other:
        run(lambda: work(other))


def test_commands_and_maps(endpoint: str) -> None:
    async def work() -> None:
        async with Fleet(endpoint) as fleet:
            robot = fleet.robot("amr7")
            assert (await robot.call(Relocalize(), PATIENT_S)).ok
            reply = await robot.call(SaveMap(name="hall"), PATIENT_S)
            assert reply.map is not None
            assert reply.map.name == "hall"
            with pytest.raises(CommandRefusedError, match="amr7: save_map: the disk is full"):
                await robot.call(SaveMap(name="full"), PATIENT_S)
            for name in ("amr8", "amr9"):
                with pytest.raises(AskingError, match=f"amr/{name}/cmd/relocalize: no answer"):
                    await fleet.robot(name).call(Relocalize(), PATIENT_S)
            with pytest.raises(AskingError, match="one robot at a time"):
                await fleet.robot("*").call(Relocalize(), PATIENT_S)
            assert len(await robot.map(PATIENT_S)) == 3_000_000
            with pytest.raises(AskingError, match="more than 1000 bytes"):
                await robot.map(PATIENT_S, max_bytes=1000)
            assert await robot.map_image(PATIENT_S) == (b"PNG", IMAGE)

    with answering(endpoint):
        run(work)


def scan_of(seq: int, points: int = 100) -> ScanMessage:
    placed = tuple((0.1 * n, float(seq)) for n in range(points))
    return ScanMessage(robot="amr7", seq=seq, stamp=1.0 * seq, map=MAP_ID, epoch=2, points=placed)


def test_scans_come_as_they_are_published_and_thinned_when_asked_for(endpoint: str) -> None:
    stop = threading.Event()

    def drive(publisher: RobotPublisher) -> None:
        seq = 0
        while not stop.wait(0.02):
            publisher.publish_scan(scan_of(seq))
            seq += 1

    async def work() -> None:
        async with Robot("amr7", endpoint=endpoint) as robot:
            seen: list[ScanMessage] = []
            scans = robot.scans()
            async for scan in scans:
                seen.append(scan)
                if len(seen) == 3:
                    break
            await scans.aclose()  # type: ignore[attr-defined]  # a generator, typed as iterator
            assert [scan.seq for scan in seen] == sorted({scan.seq for scan in seen})
            assert seen[0] == scan_of(seen[0].seq)
            thin = await robot.scan(points=10, timeout_s=PATIENT_S)
            assert thin.points == scan_of(thin.seq).points[::10]
            assert len((await robot.scan(points=2000, timeout_s=PATIENT_S)).points) == 100
            for nonsense in (0, 2001, -1):
                with pytest.raises(AskingError, match="points should be a number from 1 to 2000"):
                    await robot.scan(points=nonsense, timeout_s=PATIENT_S)

    with RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as publisher:
        thread = threading.Thread(target=drive, args=(publisher,))
        thread.start()
        try:
            run(work)
        finally:
            stop.set()
            thread.join()


def test_scans_end_when_the_robot_is_gone_and_there_is_none_before_the_first(
    endpoint: str,
) -> None:
    async def work(process: subprocess.Popen[str]) -> None:
        async with Robot("amr7", endpoint=endpoint) as robot:
            async for _ in robot.poses(PATIENT_S):
                break
            with pytest.raises(AskingError, match="amr/amr7/scan: no answer"):
                await robot.scan(points=10, timeout_s=PATIENT_S)
            process.kill()
            with pytest.raises(StalePoseError, match="amr7: gone"):
                async for _ in robot.scans():
                    pass

    with robot_process(endpoint) as process:
        run(lambda: work(process))


class Noting:
    """A session that notes the priority of what is asked."""

    def __init__(self, session: zenoh.Session) -> None:
        self.priorities: list[zenoh.Priority] = []
        self._session = session

    def get(self, *arguments: Any, **options: Any) -> Any:
        self.priorities.append(options["priority"])
        return self._session.get(*arguments, **options)


def test_maps_are_asked_for_behind_poses_and_commands(endpoint: str) -> None:
    with answering(endpoint), session("client", connect=[endpoint]) as opened:
        noting: Any = Noting(opened)
        ask_map(noting, "amr", "amr7", PATIENT_S)
        ask_map_image(noting, "amr", "amr7", PATIENT_S)
        call(noting, "amr", "amr7", Relocalize(), PATIENT_S)
    # A reply goes at the priority of its query; poses go at REAL_TIME (test_publishing).
    assert noting.priorities == [
        zenoh.Priority.DATA_LOW,
        zenoh.Priority.DATA_LOW,
        zenoh.Priority.DATA_HIGH,
    ]


def test_a_name_that_makes_no_key_costs_its_scans_only(endpoint: str) -> None:
    async def work() -> None:
        async with Fleet(endpoint) as fleet:
            with pytest.raises(SessionError, match="zenoh: "):
                async for _ in fleet.robot("amr7//x").scans():
                    pass
            assert (await fleet.robot("amr7").call(Relocalize(), PATIENT_S)).ok

    with answering(endpoint):
        run(work)


def test_sessions_are_closed_on_every_way_out(endpoint: str) -> None:
    async def work() -> None:
        fleet = Fleet(endpoint)
        with pytest.raises(ZeroDivisionError):
            async with fleet:
                1 / 0  # noqa: B018
        assert fleet.listener.session.is_closed()
        entering = Robot("amr7", endpoint=endpoint)
        task = asyncio.ensure_future(entering.__aenter__())
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        with pytest.raises(RuntimeError, match="async with"):
            entering.view  # noqa: B018
        with pytest.raises(SessionError, match="nobody answers"):
            async with Fleet(free_endpoint(), connect_timeout_s=0.3):
                pass

    with session("router", listen=[endpoint]):
        run(work)
    gc.collect()


def test_call_prints_the_reply(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    to = ["--connect", endpoint]
    with answering(endpoint):
        assert main(["call", *to, "amr7", "save_map", '{"name": "hall"}']) == 0
        assert json.loads(capsys.readouterr().out)["map"]["name"] == "hall"
        assert main(["call", *to, "amr7", "relocalize"]) == 0
        assert json.loads(capsys.readouterr().out)["ok"] is True
        assert main(["call", *to, "amr7", "save_map", '{"name": "full"}']) == 1
        assert json.loads(capsys.readouterr().out)["error"] == "the disk is full"
        assert main(["call", *to, "amr9", "relocalize"]) == 1
        assert "amr/amr9/cmd/relocalize: no answer" in capsys.readouterr().err
    for wrong in (["reboot"], ["save_map"], ["save_map", "{"], ["relocalize", '{"a": 1}']):
        assert main(["call", *to, "amr7", *wrong]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith(f"amr-slam: error: {wrong[0]}: ")


def test_the_example_follows_five_robots(endpoint: str) -> None:
    names = [f"amr{n}" for n in range(1, 6)]
    script = REPO / "docs" / "examples" / "follow_fleet.py"
    heard: set[str] = set()
    with (
        driving(endpoint, *names),
        subprocess.Popen(
            [sys.executable, "-u", str(script), endpoint, *names],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process,
    ):
        try:
            assert process.stdout is not None
            while heard < set(names):
                words = process.stdout.readline().split()
                assert words
                if words[0] != "STOP":
                    assert words[1:] == ["1.500", "-2.250", "0.500", "True"]
                    heard.add(words[0])
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=DEADLINE_S)
            assert process.returncode == 130
        finally:
            process.kill()
