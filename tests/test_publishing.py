"""Real sessions on loopback. A robot that dies or hangs is a process of its own."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest
import zenoh
from messages import pose_of, status_of
from paths import REPO

from amr_slam.client import FleetListener, RobotView, SessionError
from amr_slam.publishing import RobotPublisher
from amr_slam.samples import State
from amr_slam.wire import MAX_MESSAGE_BYTES, PoseMessage, StatusMessage, ZenohSettings

DEADLINE_S = 20.0

# A robot that publishes until it is told to stop by the end of its standard input.
ROBOT = """
import sys, threading
sys.path.insert(0, sys.argv[2])
from messages import pose_of, status_of
from amr_slam.publishing import RobotPublisher
from amr_slam.wire import ZenohSettings

told = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), told.set()), daemon=True).start()
with RobotPublisher(ZenohSettings(listen=(sys.argv[1],)), "amr7") as robot:
    robot.publish_status(status_of())
    print("ready", flush=True)
    seq = 0
    while not told.wait(0.02):
        robot.publish_pose(pose_of(seq=seq))
        seq += 1
"""


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@contextmanager
def robot_process(endpoint: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", ROBOT, endpoint, str(REPO / "tests")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


@contextmanager
def session(mode: str, **options: Any) -> Iterator[zenoh.Session]:
    """Somebody else on the network, who shares no code with the robot."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for name, endpoints in options.items():
        config.insert_json5(f"{name}/endpoints", json.dumps(endpoints))
    # close() while a thread of zenoh's puts is fine; the end of a "with" raises then
    with closing(zenoh.open(config)) as opened:
        yield opened


def repeat_until(act: Callable[[], None], done: Callable[[], bool]) -> None:
    """As a robot does: the first messages are lost, as nobody is known to listen yet."""
    deadline = time.monotonic() + DEADLINE_S
    while not done():
        assert time.monotonic() < deadline
        act()
        time.sleep(0.02)


def alive(robot: str = "amr7") -> Callable[[dict[str, RobotView]], bool]:
    return lambda views: robot in views and views[robot].alive


def gone(robot: str = "amr7") -> Callable[[dict[str, RobotView]], bool]:
    return lambda views: robot in views and not views[robot].alive


def test_a_listener_sees_the_pose_the_status_and_that_the_robot_is_there(endpoint: str) -> None:
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot,
        FleetListener(endpoint) as fleet,
    ):
        assert fleet.wait_for(alive(), DEADLINE_S)
        sent_pose, sent_status = pose_of(fault="rear: standby"), status_of()

        def publish() -> None:
            robot.publish_pose(sent_pose)
            robot.publish_status(sent_status)

        repeat_until(publish, lambda: both(fleet.views()["amr7"]))
        view = fleet.views()["amr7"]
        assert view.pose == sent_pose
        assert view.status == sent_status
        assert 0.0 <= view.pose_age_s() < DEADLINE_S
        assert view.refused == 0


def both(view: RobotView) -> bool:
    return view.pose is not None and view.status is not None


def pose(fleet: FleetListener, robot: str = "amr7") -> PoseMessage | None:
    return fleet.views()[robot].pose


def test_poses_come_in_order_and_none_is_lost_on_loopback(endpoint: str) -> None:
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot,
        FleetListener(endpoint) as fleet,
    ):
        repeat_until(
            lambda: robot.publish_pose(pose_of(epoch=0)),
            lambda: fleet.next_pose(0.0) is not None,
        )
        for seq in range(100):
            robot.publish_pose(pose_of(seq=seq, epoch=1))
            time.sleep(0.005)  # four times the robot's pace; a burst may drop, by intent
        received: list[PoseMessage] = []
        while not received or received[-1].seq < 99:
            next_pose = fleet.next_pose(DEADLINE_S)
            assert next_pose is not None
            received += [next_pose] if next_pose.epoch == 1 else []
        assert [message.seq for message in received] == list(range(100))
        assert fleet.next_pose(0.0) is None


@pytest.mark.parametrize("every", [5, 0])
def test_every_nth_pose_goes_out_for_the_fleet_and_its_gaps_are_no_losses(
    endpoint: str, every: int
) -> None:
    settings = ZenohSettings(listen=(endpoint,), fleet_every=every)
    with (
        RobotPublisher(settings, "amr7") as robot,
        FleetListener(endpoint, ["amr7"], full_rate=False) as fleet,
        FleetListener(endpoint, ["amr7"]) as vehicle,
    ):
        sent = iter(range(10_000))

        def publish() -> None:
            robot.publish_pose(pose_of(seq=next(sent)))

        repeat_until(publish, lambda: vehicle.views()["amr7"].poses >= 50)
        if not every:
            assert fleet.views()["amr7"].poses == 0
            return
        repeat_until(publish, lambda: fleet.views()["amr7"].poses >= 10)
        view = fleet.views()["amr7"]
        heard = [pose.seq for pose in iter(lambda: fleet.next_pose(0.0), None)]
        assert heard == list(range(heard[0], heard[-1] + 1, every))
        assert heard[0] % every == 0
        assert view.pose is not None
        assert (view.pose.every, view.lost, view.refused) == (every, 0, 0)


def test_a_pose_that_is_lost_of_every_nth_is_counted_once(endpoint: str) -> None:
    with (
        session("peer", listen=[endpoint]) as network,
        FleetListener(endpoint, ["amr7"], full_rate=False) as fleet,
    ):

        def put(seq: int) -> None:
            network.put("amr/amr7/fleet_pose", pose_of(seq=seq, every=10).encode())

        repeat_until(lambda: put(0), lambda: fleet.views()["amr7"].poses > 0)
        for seq in (10, 20, 50, 60):  # 30 and 40 are missing
            put(seq)
        assert fleet.wait_for(lambda views: (views["amr7"].pose or pose_of()).seq == 60, DEADLINE_S)
        assert fleet.views()["amr7"].lost == 2


def test_who_comes_late_has_the_pose_and_the_status_at_once(endpoint: str) -> None:
    stop = threading.Event()
    with RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot:
        robot.publish_status(status_of(seq=5))  # and not again

        def drive() -> None:
            seq = 0
            while not stop.wait(0.02):
                robot.publish_pose(pose_of(seq=seq))
                seq += 1

        thread = threading.Thread(target=drive)
        thread.start()
        try:
            with FleetListener(endpoint) as late:
                assert late.wait_for(lambda v: "amr7" in v and both(v["amr7"]), DEADLINE_S)
                assert late.views()["amr7"].status == status_of(seq=5)
        finally:
            stop.set()
            thread.join()


def test_the_oldest_poses_go_when_nobody_takes_them(endpoint: str) -> None:
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot,
        FleetListener(endpoint, queue_size=3) as fleet,
    ):
        sent = iter(range(10_000))
        repeat_until(
            lambda: robot.publish_pose(pose_of(seq=next(sent))),
            lambda: "amr7" in fleet.views() and (pose(fleet) or pose_of()).seq >= 20,
        )
        newest = next(sent)
        robot.publish_pose(pose_of(seq=newest))
        assert fleet.wait_for(
            lambda views: (views["amr7"].pose or pose_of()).seq == newest, DEADLINE_S
        )
        taken = iter(lambda: fleet.next_pose(0.0), None)
        assert [message.seq for message in taken] == [newest - 2, newest - 1, newest]


def test_get_answers_with_the_latest_also_those_who_come_late(endpoint: str) -> None:
    with RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot:
        for seq in range(3):
            robot.publish_pose(pose_of(seq=seq))
        with session("client", connect=[endpoint]) as late:
            replies = [r.ok for r in late.get("amr/*/pose", timeout=DEADLINE_S) if r.ok]
            assert [str(reply.key_expr) for reply in replies] == ["amr/amr7/pose"]
            assert replies[0].encoding == zenoh.Encoding.APPLICATION_JSON
            assert PoseMessage.decode(replies[0].payload.to_bytes()) == pose_of(seq=2)
            assert not list(late.get("amr/amr7/status", timeout=DEADLINE_S))  # nothing said yet
            robot.publish_status(status_of(seq=5))
            (status,) = [r.ok for r in late.get("amr/amr7/status", timeout=DEADLINE_S) if r.ok]
            assert StatusMessage.decode(status.payload.to_bytes()) == status_of(seq=5)


def test_poses_go_drop_with_a_priority_of_their_own_and_no_express(endpoint: str) -> None:
    seen: dict[str, zenoh.Sample] = {}
    with (
        RobotPublisher(ZenohSettings(prefix="site/amr", listen=(endpoint,)), "amr7") as robot,
        session("client", connect=[endpoint]) as other,
    ):
        other.declare_subscriber(
            "site/amr/amr7/*", lambda sample: seen.update({str(sample.key_expr): sample})
        )

        def publish() -> None:
            robot.publish_pose(pose_of())
            robot.publish_status(status_of())

        repeat_until(publish, lambda: len(seen) == 3)
    sent, status = seen["site/amr/amr7/pose"], seen["site/amr/amr7/status"]
    for poses in (sent, seen["site/amr/amr7/fleet_pose"]):
        assert poses.priority == zenoh.Priority.REAL_TIME
        assert poses.congestion_control == zenoh.CongestionControl.DROP
        assert not poses.express
        assert poses.encoding == zenoh.Encoding.APPLICATION_JSON
    assert status.priority != sent.priority
    assert status.congestion_control == zenoh.CongestionControl.DROP


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_alive_falls_when_the_robot_dies_or_hangs(endpoint: str, ending: signal.Signals) -> None:
    with robot_process(endpoint) as process, FleetListener(endpoint, ["amr7"]) as fleet:
        assert fleet.wait_for(lambda views: alive()(views) and pose(fleet) is not None, DEADLINE_S)
        started = time.monotonic()
        os.kill(process.pid, ending)
        assert fleet.wait_for(gone(), DEADLINE_S)
        # The contract's lease is 1 s; zenoh's own default would take ten.
        assert time.monotonic() - started < 5.0
        assert pose(fleet) is not None  # kept, and told to be old
        assert fleet.views()["amr7"].pose_age_s() > 0.0


def test_closing_does_not_hang_on_a_frozen_router(endpoint: str) -> None:
    with (
        robot_process(endpoint) as process,
        RobotPublisher(ZenohSettings(listen=(), connect=(endpoint,)), "amr8") as own,
        FleetListener(endpoint) as fleet,
    ):
        assert fleet.wait_for(alive(), DEADLINE_S)
        os.kill(process.pid, signal.SIGSTOP)
        assert fleet.wait_for(gone(), DEADLINE_S)
        started = time.monotonic()
        own.close()
        fleet.close()
        assert time.monotonic() - started < 8.0  # ten seconds and an error by zenoh's defaults


def test_a_listener_finds_the_robot_again_after_its_restart(endpoint: str) -> None:
    with robot_process(endpoint) as first:
        fleet = FleetListener(endpoint)
        with fleet:
            assert fleet.wait_for(alive(), DEADLINE_S)
            first.kill()
            assert fleet.wait_for(gone(), DEADLINE_S)
            first.wait()
            with robot_process(endpoint):
                assert fleet.wait_for(alive(), DEADLINE_S)
                while (fleet.next_pose(0.0)) is not None:
                    pass
                assert fleet.next_pose(DEADLINE_S) is not None


def test_a_closed_session_lets_the_interpreter_end(endpoint: str) -> None:
    with robot_process(endpoint) as process, FleetListener(endpoint) as fleet:
        assert fleet.wait_for(alive(), DEADLINE_S)
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(DEADLINE_S) == 0
        assert fleet.wait_for(gone(), DEADLINE_S)


def test_a_robot_starts_without_its_router_and_is_seen_when_it_comes(endpoint: str) -> None:
    settings = ZenohSettings(listen=(), connect=(endpoint,))
    with RobotPublisher(settings, "amr7") as robot:
        robot.publish_pose(pose_of())  # into nothing: neither raises nor waits
        with session("router", listen=[endpoint]), FleetListener(endpoint) as fleet:
            assert fleet.wait_for(alive(), DEADLINE_S)
            repeat_until(
                lambda: robot.publish_pose(pose_of(seq=1)), lambda: pose(fleet) is not None
            )


def test_what_is_no_message_of_the_robot_is_counted_and_dropped(endpoint: str) -> None:
    bad = [b"", b"{}", b"x" * (MAX_MESSAGE_BYTES + 1), pose_of("amr8").encode()]
    with session("peer", listen=[endpoint]) as forger, FleetListener(endpoint) as fleet:
        other = forger.declare_publisher("amr/amr7/pose")
        good = pose_of(seq=1)

        def put_good() -> None:
            other.put(good.encode())

        repeat_until(put_good, lambda: "amr7" in fleet.views())
        for payload in bad:
            other.put(payload)
        forger.put("amr/amr7/status", pose_of().encode())
        assert fleet.wait_for(lambda views: views["amr7"].refused == 5, DEADLINE_S)
        assert pose(fleet) == good
        assert set(fleet.views()) == {"amr7"}


def test_a_listener_may_follow_some_robots_only(endpoint: str) -> None:
    with (
        session("peer", listen=[endpoint]) as network,
        FleetListener(endpoint, ["amr7", "amr9"]) as fleet,
    ):

        def publish() -> None:
            for robot in ("amr8", "amr7"):
                network.put(f"amr/{robot}/pose", pose_of(robot).encode())

        repeat_until(publish, lambda: pose(fleet) is not None)
        assert set(fleet.views()) == {"amr7", "amr9"}
        assert fleet.views()["amr9"] == RobotView(robot="amr9")


def test_a_port_in_use_is_one_line(endpoint: str) -> None:
    settings = ZenohSettings(listen=(endpoint,))
    with RobotPublisher(settings, "amr7"), pytest.raises(SessionError) as refused:
        RobotPublisher(settings, "amr8")
    assert endpoint in str(refused.value)
    assert "in use" in str(refused.value)
    assert "\n" not in str(refused.value)
    assert ".rs" not in str(refused.value)


def test_nobody_at_the_endpoint_is_one_line(endpoint: str) -> None:
    with pytest.raises(SessionError, match=endpoint):
        FleetListener(endpoint, connect_timeout_s=0.3)


def test_a_name_that_makes_no_key_is_one_line_and_leaves_nothing_open(endpoint: str) -> None:
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7"),
        pytest.raises(SessionError, match="zenoh: "),
    ):
        FleetListener(endpoint, ["amr7//x"])
    with pytest.raises(SessionError, match="zenoh: "):
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7?")
    RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7").close()  # the port is free again


def test_a_state_that_changes_is_seen(endpoint: str) -> None:
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot,
        FleetListener(endpoint) as fleet,
    ):
        for state in (State.LOCALIZED, State.LOST):
            told = pose_of(state=state)

            def publish(told: PoseMessage = told) -> None:
                robot.publish_pose(told)

            def seen(told: PoseMessage = told) -> bool:
                return "amr7" in fleet.views() and pose(fleet) == told

            repeat_until(publish, seen)
