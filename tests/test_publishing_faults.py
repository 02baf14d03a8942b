"""A robot among listeners that hang and routers that go, and ``watch`` as people start it."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import zenoh
from messages import pose_of, status_of

from amr_slam.client import FleetListener
from amr_slam.publishing import RobotPublisher
from amr_slam.samples import State
from amr_slam.wire import CommandReply, ZenohSettings

DEADLINE_S = 20.0
LISTENER = """
import sys
from amr_slam.client import FleetListener

with FleetListener(sys.argv[1], ["amr7"]) as fleet:
    while fleet.next_pose(20.0) is not None:
        print("heard", flush=True)
"""


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def python(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A process of its own, killed in the end."""
    with subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        bufsize=1,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def driving(robot: RobotPublisher) -> Iterator[None]:
    """``robot`` publishes at 50 Hz meanwhile."""
    stop = threading.Event()

    def drive() -> None:
        seq = 0
        while not stop.wait(0.02):
            robot.publish_pose(pose_of(seq=seq, state=State.ODOMETRY_ONLY, fault="front: standby"))
            robot.publish_status(status_of(seq=seq))
            seq += 1

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


@contextmanager
def router(endpoint: str) -> Iterator[None]:
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config):
        yield


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def test_a_frozen_listener_holds_up_neither_the_robot_nor_the_others(endpoint: str) -> None:
    settings = ZenohSettings(listen=(endpoint,))
    longest_s = 0.0
    with RobotPublisher(settings, "amr7") as robot, python("-c", LISTENER, endpoint) as frozen:
        with driving(robot):
            assert line_of(frozen) == "heard\n"
        frozen.send_signal(signal.SIGSTOP)
        with FleetListener(endpoint, ["amr7"]) as fleet:
            # 20 MB: more than the sockets and zenoh's queues hold for who does not read.
            for seq in range(20_000):
                message = pose_of(seq=seq, fault="." * 500)
                before = time.monotonic()
                robot.publish_pose(message)
                longest_s = max(longest_s, time.monotonic() - before)
            with driving(robot):
                assert fleet.wait_for(
                    lambda views: getattr(views["amr7"].pose, "fault", "") == "front: standby",
                    DEADLINE_S,
                )
    assert longest_s < 1.0  # waiting for the frozen one would take 5 s


def test_a_robot_outlives_its_router(endpoint: str) -> None:
    settings = ZenohSettings(listen=(), connect=(endpoint,))
    with RobotPublisher(settings, "amr7") as robot, driving(robot):
        for _ in range(2):
            with router(endpoint), FleetListener(endpoint) as fleet:
                assert fleet.next_pose(DEADLINE_S) is not None
                assert fleet.wait_for(lambda views: views["amr7"].alive, DEADLINE_S)


def test_watch_prints_a_line_for_each_robot_until_ctrl_c(endpoint: str) -> None:
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot,
        driving(robot),
        python("-m", "amr_slam", "watch", "--connect", endpoint, "amr7", "amr8") as watch,
    ):
        first = line_of(watch)
        while "state=odometry_only" not in first:  # before the robot was heard
            assert " amr7 " in first or " amr8 " in first
            first = line_of(watch)
        assert re.fullmatch(
            r"\S+ amr7 state=odometry_only x_m=1\.500 y_m=-2\.250 theta_deg=28\.65 "
            r"error95_m=0\.050 age_s=\d+\.\d\d fix_s=1\.5 rate_Hz=\S+ map=hall epoch=2 "
            r"health=front: standby\n",
            first,
        )
        assert re.fullmatch(r"\S+ amr8 state=absent .*\n", line_of(watch))
        watch.send_signal(signal.SIGINT)
        _, said = watch.communicate(timeout=DEADLINE_S)
        assert (watch.returncode, said) == (130, "")


def test_watch_once_shows_what_there_is_and_ends(endpoint: str) -> None:
    settings = ZenohSettings(listen=(endpoint,), prefix="works/hall3")
    shared = ["-m", "amr_slam", "watch", "--connect", endpoint, "--prefix", "works/hall3", "--once"]
    with RobotPublisher(settings, "amr7") as robot, driving(robot):
        with python(*shared) as watch:
            shown, said = watch.communicate(timeout=DEADLINE_S)
        assert (watch.returncode, said) == (0, "")
        assert re.search(
            r"amr7 .*odometry_only .* 1\.500 .* -2\.250 .* hall .* front: standby", shown
        )
        assert "\x1b" not in shown
        with python(*shared, "--json", "amr7", "amr8") as watch:
            shown, said = watch.communicate(timeout=DEADLINE_S)
        assert (watch.returncode, said) == (0, "")
        first, second = map(json.loads, shown.splitlines())
        assert (first["robot"], first["state"], first["pose"]["x"]) == (
            "amr7",
            "odometry_only",
            1.5,
        )
        assert first["status"]["map"]["name"] == "hall"
        assert first["rate_hz"] > 0.0
        assert (second["robot"], second["state"], second["pose"]) == ("amr8", "absent", None)


def test_call_and_watch_look_under_the_prefix_they_are_given(endpoint: str) -> None:
    settings = ZenohSettings(listen=(endpoint,), prefix="works/hall3")
    with RobotPublisher(settings, "amr7") as robot:
        robot.serve(lambda asked: asked.done(CommandReply(ok=True)))
        call = ["-m", "amr_slam", "call", "--connect", endpoint, "--timeout", "5"]
        with python(*call, "--prefix", "works/hall3", "amr7", "relocalize") as there:
            shown, said = there.communicate(timeout=DEADLINE_S)
        assert (there.returncode, json.loads(shown)["ok"], said) == (0, True, "")
        with python(*call, "amr7", "relocalize") as nowhere:
            shown, said = nowhere.communicate(timeout=DEADLINE_S)
        assert (nowhere.returncode, shown) == (1, "")
        assert said == "amr-slam: error: amr/amr7/cmd/relocalize: no answer\n"


def test_watch_says_that_nobody_is_there(endpoint: str) -> None:
    with python("-m", "amr_slam", "watch", "--connect", endpoint) as watch:
        shown, said = watch.communicate(timeout=DEADLINE_S)
    assert (watch.returncode, shown) == (1, "")
    assert said == f"amr-slam: error: zenoh {endpoint}: nobody answers\n"


def test_watch_wants_an_endpoint() -> None:
    with python("-m", "amr_slam", "watch", "--connect", "amr7.local") as watch:
        _, said = watch.communicate(timeout=DEADLINE_S)
    assert watch.returncode == 1
    assert re.fullmatch(r"amr-slam: error: zenoh amr7\.local: Endpoints must be of .*\n", said)
