"""A router, robots and controllers in processes of their own: killed, frozen, come back."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_publishing import free_endpoint, repeat_until

from amr_slam.client import Fleet, FleetListener, StalePoseError
from amr_slam.studies.fleet.measuring import hear
from amr_slam.studies.fleet.processes import Program, program
from amr_slam.studies.fleet.robots import name_of
from amr_slam.wire import PoseMessage

DEADLINE_S = 30.0
NAME = name_of(0)
BACK_S = 8.0
"""Contract: 2 s; the machine of the tests has much else to do (figures: docs/fleet-scale.md)."""


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def robot(endpoint: str) -> Iterator[Program]:
    with program("robots", endpoint) as started:
        yield started


def next_pose(fleet: FleetListener) -> PoseMessage:
    pose = fleet.next_pose(DEADLINE_S)
    assert pose is not None
    return pose


def forget(fleet: FleetListener) -> None:
    while fleet.next_pose(0.0) is not None:
        pass


def test_a_router_that_is_killed_and_comes_back(endpoint: str, robot: Program) -> None:
    with program("router", endpoint) as first, FleetListener(endpoint, [NAME]) as fleet:
        last = next_pose(fleet)
        first.process.kill()
        first.process.wait()
        assert fleet.wait_for(lambda views: not views[NAME].alive, DEADLINE_S)
        repeat_until(lambda: None, lambda: fleet.views()[NAME].pose_age_s() > 1.0)
        forget(fleet)
        begun_s = time.monotonic()
        with program("router", endpoint) as second:
            returned_s = time.monotonic()
            pose = next_pose(fleet)
            assert time.monotonic() - returned_s < BACK_S
            assert fleet.wait_for(lambda views: views[NAME].alive, DEADLINE_S)
            # What was said meanwhile is not said again, and the loop went on saying it.
            assert pose.stamp > begun_s
            assert pose.seq - last.seq > 50 * (pose.stamp - last.stamp) - 25
            assert fleet.views()[NAME].restarts == 0
            told = robot.end()
            second.stop()
    assert told["longest_put_s"] < 1.0


def test_a_robot_that_is_there_before_its_router(endpoint: str, robot: Program) -> None:
    time.sleep(1.5)  # past the first tries: the gaps between them have their full length
    with program("router", endpoint) as router:
        returned_s = time.monotonic()
        with FleetListener(endpoint, [NAME]) as fleet:
            pose = next_pose(fleet)
            assert time.monotonic() - returned_s < BACK_S
            assert pose.stamp > returned_s - 1.0
            assert robot.end()["longest_put_s"] < 1.0
        router.stop()


def test_a_frozen_robot_is_stale_at_once_and_gone_soon(endpoint: str, robot: Program) -> None:
    async def work() -> tuple[float, float]:
        async with Fleet(endpoint, [NAME]) as fleet:
            one = fleet.robot(NAME)
            async for _ in one.poses(DEADLINE_S):
                break
            robot.process.send_signal(signal.SIGSTOP)
            begun_s = time.monotonic()
            with pytest.raises(StalePoseError):
                async for _ in one.poses(stale_s=0.5):
                    pass
            stale_s = time.monotonic() - begun_s
            while one.alive:
                await fleet.changed(NAME, 0.1)
            with pytest.raises(StalePoseError, match="gone"):
                one.pose(DEADLINE_S)
            gone_s = time.monotonic() - begun_s
            robot.process.send_signal(signal.SIGCONT)  # and is used again as if nothing had been
            async for pose in one.poses(DEADLINE_S):
                if pose.stamp > begun_s + gone_s:
                    break
            return stale_s, gone_s

    with program("router", endpoint) as router:
        stale_s, gone_s = asyncio.run(asyncio.wait_for(work(), 2 * DEADLINE_S))
        assert stale_s < 3.0  # half a second on an idle machine
        assert gone_s < 5.0  # contract: 1.5 s; zenoh's own default would be ten
        robot.stop()
        router.stop()


def test_a_frozen_controller_disturbs_neither_the_robot_nor_the_others(
    endpoint: str, robot: Program
) -> None:
    with (
        program("router", endpoint) as router,
        program("controller", endpoint) as frozen,
        FleetListener(endpoint, [NAME]) as other,
    ):
        next_pose(other)
        while frozen.ask()["heard"] < 1:
            pass
        frozen.process.send_signal(signal.SIGSTOP)
        before = other.views()[NAME]
        assert other.wait_for(lambda views: views[NAME].poses > before.poses + 150, DEADLINE_S)
        assert other.views()[NAME].lost == before.lost
        frozen.process.send_signal(signal.SIGCONT)
        told = frozen.ask()
        assert (told["lost"], told["refused"], told["restarts"]) == (0, 0, 0)
        frozen.stop()
        assert robot.end()["longest_put_s"] < 1.0
        router.stop()


def test_many_robots_are_heard_without_a_loss_while_the_processors_are_busy(endpoint: str) -> None:
    heard = hear(endpoint, 3.0, robots=4, processes=2, busy_processes=3)
    assert heard.lost == 0
    assert heard.received > 0.5 * heard.offered_hz * heard.seconds
    assert set(heard.cpu_percent) == {"robots", "router", "controller"}
    assert heard.memory_mb_each > 0.0


ENDS = {
    "an exception": "raise ZeroDivisionError",
    "sys.exit": "sys.exit(3)",
    "Ctrl-C": "signal.raise_signal(signal.SIGINT)",
    "SIGTERM": "signal.raise_signal(signal.SIGTERM)",
}
HOLDERS = {
    "a robot": """
with RobotPublisher(ZenohSettings(listen=(), connect=(sys.argv[1],)), "amr7") as robot:
    robot.publish_pose(pose_of())
    END
""",
    "a controller": """
async def work():
    async with Robot("amr7", endpoint=sys.argv[1]) as robot:
        END

asyncio.run(work())
""",
    "a listener": """
with FleetListener(sys.argv[1]) as fleet:
    fleet.next_pose(0.1)
    END
""",
}


@pytest.mark.parametrize("holder", HOLDERS)
@pytest.mark.parametrize("end", ENDS)
def test_a_program_ends_whatever_ends_it(endpoint: str, holder: str, end: str) -> None:
    """A session that stays open keeps the interpreter from ending, for ever."""
    script = "\n".join(
        (
            "import asyncio, signal, sys",
            "from messages import pose_of",
            "from amr_slam.client import FleetListener, Robot",
            "from amr_slam.publishing import RobotPublisher",
            "from amr_slam.wire import ZenohSettings",
            "signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))",
            HOLDERS[holder].replace("END", ENDS[end]),
        )
    )
    with program("router", endpoint) as router:
        ended = subprocess.run(
            [sys.executable, "-c", script, endpoint],
            check=False,
            timeout=DEADLINE_S,
            capture_output=True,
            text=True,
            env=os.environ
            | {"PYTHONPATH": os.pathsep.join([*sys.path, str(Path(__file__).parent)])},
        )
        router.stop()
    expected = {"an exception": 1, "sys.exit": 3, "Ctrl-C": -signal.SIGINT, "SIGTERM": 0}
    assert ended.returncode == expected[end], ended.stderr
