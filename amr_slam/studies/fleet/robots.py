"""Robots that publish as the daemon does: ``robots ENDPOINT --count 25 --hz 50``.

Each has a session of its own and goes through :class:`amr_slam.publishing.RobotPublisher` with
messages of its own; several share a process, whose one thread takes them in turn, evenly over the
period. ``--qos`` replaces the publisher by one with another quality of service, for comparison.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, Protocol, Self

import zenoh

from amr_slam.client import close_session
from amr_slam.map.file import identity
from amr_slam.publishing import RobotPublisher
from amr_slam.samples import State
from amr_slam.serving import Asked, MapFile, MapWanted
from amr_slam.studies.fleet.programs import memory_mb, ready, say, wait_for_end
from amr_slam.wire import (
    HealthPart,
    OdomPose,
    PoseMessage,
    StatusMessage,
    Topic,
    ZenohSettings,
    robot_key,
)

PRODUCT: Final = "product"
VARIANTS: Final = {
    "express, DROP, queue of 2": (True, zenoh.CongestionControl.DROP, 2),
    "express, DROP, queue of 16": (True, zenoh.CongestionControl.DROP, 16),
    "DROP, queue of 2": (False, zenoh.CongestionControl.DROP, 2),
    "BLOCK, queue of 2": (False, zenoh.CongestionControl.BLOCK, 2),
}
"""Express, congestion control, batches in the queue (2: zenoh's own). The product: DROP, 16."""
_MAP_ID: Final = "6f1d6a44-7f0c-4b2c-9df0-0d5b4b4f3c11"
_WELL: Final = HealthPart(link="OK", age_s=0.04, rate_hz=0.5, samples=1000, errors=0)


class _Publisher(Protocol):
    def publish_pose(self, message: PoseMessage) -> None: ...

    def publish_status(self, message: StatusMessage) -> None: ...


class _Variant:
    """Publishes poses with another quality of service; says nothing else but that it is alive."""

    def __init__(self, endpoint: str, robot: str, name: str) -> None:
        express, congestion_control, queue = VARIANTS[name]
        config = zenoh.Config()
        for path, value in {
            "mode": "peer",
            "listen/endpoints": [],
            "connect/endpoints": [endpoint],
            "scouting/multicast/enabled": False,
            "transport/link/tx/queue/size/real_time": queue,
        }.items():
            config.insert_json5(path, json.dumps(value))
        self._session = zenoh.open(config)
        self._pose = self._session.declare_publisher(
            robot_key("amr", robot, Topic.POSE),
            congestion_control=congestion_control,
            priority=zenoh.Priority.REAL_TIME,
            express=express,
        )
        alive = robot_key("amr", robot, Topic.ALIVE)
        self._alive = self._session.liveliness().declare_token(alive)

    def publish_pose(self, message: PoseMessage) -> None:
        self._pose.put(message.encode())

    def publish_status(self, message: StatusMessage) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        close_session(self._session)


def main(argv: Sequence[str] | None = None) -> int:
    """Publish until standard input ends; then say how it went."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("endpoint", help="of the router")
    parser.add_argument("--first", type=int, default=0, help="number in the first one's name")
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--hz", type=float, default=50.0)
    parser.add_argument("--qos", choices=(PRODUCT, *VARIANTS), default=PRODUCT)
    parser.add_argument("--map", type=Path, help="what is answered to who asks for the map")
    arguments = parser.parse_args(argv)
    names = [name_of(arguments.first + n) for n in range(arguments.count)]
    before_mb = memory_mb()
    with ExitStack() as opened:
        robots = [_opened(arguments, name, opened) for name in names]
        ended = wait_for_end()
        ready()
        sent, longest_s, begun_s = 0, 0.0, time.monotonic()
        while not ended.is_set():
            due_s = begun_s + sent / (arguments.hz * len(names))
            ended.wait(max(0.0, due_s - time.monotonic()))
            turn, which = divmod(sent, len(names))
            taken_s = _turn(robots[which], names[which], turn, arguments.hz)
            longest_s = max(longest_s, taken_s)
            sent += 1
        memory = memory_mb() - before_mb
    say({"sent": sent, "longest_put_s": longest_s, "memory_mb_each": memory / len(names)})
    return 0


def pose_bytes() -> int:
    """Of one pose, as JSON."""
    return len(_pose(name_of(0), 12_345).encode())


def name_of(number: int) -> str:
    """``amr0001`` and so on."""
    return f"amr{number:04d}"


def _opened(arguments: argparse.Namespace, name: str, opened: ExitStack) -> _Publisher:
    if arguments.qos != PRODUCT:
        return opened.enter_context(_Variant(arguments.endpoint, name, arguments.qos))
    settings = ZenohSettings(listen=(), connect=(arguments.endpoint,))
    robot = opened.enter_context(RobotPublisher(settings, name))
    if arguments.map is not None:
        map_id = str(identity(arguments.map.read_bytes()))

        def answer(asked: Asked) -> None:
            if isinstance(asked.request, MapWanted):
                asked.done(MapFile(path=arguments.map, map_id=map_id))
            else:
                asked.not_done("this robot only has a map")

        robot.serve(answer)
    return robot


def _turn(robot: _Publisher, name: str, turn: int, hz: float) -> float:
    """Publish what is due; returns the seconds for which that kept the loop."""
    pose, status = _pose(name, turn), _status(name, turn) if turn % round(hz) == 0 else None
    begun_s = time.monotonic()
    robot.publish_pose(pose)
    if status is not None:
        robot.publish_status(status)
    return time.monotonic() - begun_s


def _pose(robot: str, seq: int) -> PoseMessage:
    """Round a circle. The stamp is this machine's monotonic time, as all readers are on it."""
    angle = 0.01 * seq
    x, y, theta = 5.0 * math.cos(angle), 5.0 * math.sin(angle), math.remainder(angle, 2.0 * math.pi)
    return PoseMessage(
        robot=robot,
        seq=seq,
        stamp=time.monotonic(),
        age_s=0.000653,
        map=_MAP_ID,
        epoch=0,
        x=x,
        y=y,
        theta=theta,
        vx=0.197 + 1e-3 * math.sin(angle),
        omega=0.293 + 1e-3 * math.cos(angle),
        covariance=(
            4.7e-05,
            4.81e-06,
            -4.3e-05,
            4.81e-06,
            4.4e-05,
            -7.3e-05,
            -4.3e-05,
            -7.3e-05,
            3.8e-04,
        ),
        error95_m=0.0166 + 1e-4 * math.sin(angle),
        state=State.LOCALIZED,
        since_fix_s=0.02 * (seq % 100),
        since_fix_m=0.004 * (seq % 100),
        odom=OdomPose(x=x + 0.001, y=y - 0.013, theta=theta),
        fault=None,
    )


def _status(robot: str, seq: int) -> StatusMessage:
    return StatusMessage(
        robot=robot,
        seq=seq,
        stamp=time.monotonic(),
        state=State.LOCALIZED,
        mode="localization",
        map=None,
        scanners={"front": _WELL, "rear": _WELL},
        wheels=_WELL,
        slam=_WELL,
        version="study",
        uptime_s=1.0,
        cpu_percent=1.0,
        memory_mb=1.0,
    )


if __name__ == "__main__":
    sys.exit(main())
