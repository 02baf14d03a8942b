"""What each further form of a pose costs the loop: microseconds per pose.

``encode``: messages to bytes alone. ``publish``: JSON, the form and Zenoh's ``put`` of all, with
nobody listening, and with one session that listens to everything; the first line is JSON alone.
Example: python benchmarks/encodings.py
"""

from __future__ import annotations

import argparse
import socket
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Final

import numpy as np
import zenoh

from amr_slam.encodings import Encoder, vda5050
from amr_slam.encodings.ros2 import Ros2Encoder, Ros2Settings
from amr_slam.publishing import RobotPublisher
from amr_slam.states import State
from amr_slam.wire import OdomPose, PoseMessage, ZenohSettings

_ROBOT: Final = "amr7"
_PERIOD_S: Final = 0.002
"""Ten times the robot's rate: queues stay empty, caches do not."""


def main() -> int:
    """Measure and print a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--poses", type=int, default=3000, help="of each measurement")
    count = parser.parse_args().poses
    print("| form | messages a pose | encode us | publish, unheard us | publish, heard us |")
    print("|---|--:|--:|--:|--:|")
    for name, encoders in forms().items():
        messages = encode_all(encoders, pose(0))
        encode = measured(partial(encode_all, encoders), count)
        unheard = published(encoders, count, heard=False)
        heard = published(encoders, count, heard=True)
        print(f"| {name} | {1 + messages} | {encode} | {unheard} | {heard} |")
    return 0


def forms() -> dict[str, list[Encoder]]:
    """Encoders by what the configuration switches on."""

    def ros2(*, plain: bool = False, rmw_zenoh: bool = False) -> list[Encoder]:
        settings = Ros2Settings(plain=plain, rmw_zenoh=rmw_zenoh)
        return [Ros2Encoder(settings, _ROBOT, b"benchmark")]

    def vda(*, visualization_hz: float) -> list[Encoder]:
        settings = vda5050.Vda5050Settings(
            versions=("2.1", "3.0"), manufacturer="acme", visualization_hz=visualization_hz
        )
        return vda5050.encoders(settings, prefix="amr", robot=_ROBOT, pose_hz=50.0)

    return {
        "JSON alone": [],
        "ROS 2, plain keys": ros2(plain=True),
        "ROS 2, rmw_zenoh": ros2(rmw_zenoh=True),
        "ROS 2, both": ros2(plain=True, rmw_zenoh=True),
        "VDA 5050, both, every pose": vda(visualization_hz=50.0),
        "VDA 5050, both, 10 Hz": vda(visualization_hz=10.0),
    }


def encode_all(encoders: Sequence[Encoder], message: PoseMessage) -> int:
    """How many messages they make."""
    return sum(len(list(encoder.pose(message))) for encoder in encoders)


def pose(seq: int) -> PoseMessage:
    """A localized robot's."""
    return PoseMessage(
        robot=_ROBOT,
        seq=seq,
        stamp=1_790_000_000.0 + 0.02 * seq,
        age_s=0.001,
        map="6f1d6a44-7f0c-4b2c-9df0-0d5b4b4f3c11",
        epoch=1,
        x=1.0 + 0.001 * seq,
        y=-2.0,
        theta=0.5,
        vx=0.3,
        omega=0.1,
        covariance=(1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 4e-4),
        error95_m=0.02,
        state=State.LOCALIZED,
        since_fix_s=1.0,
        since_fix_m=0.3,
        odom=OdomPose(x=4.0, y=5.0, theta=-1.0),
        fault=None,
    )


def published(encoders: Sequence[Encoder], count: int, *, heard: bool) -> str:
    """Of ``publish_pose`` on a real session."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    received: list[int] = []
    with ExitStack() as stack:
        settings = ZenohSettings(listen=(endpoint,))
        publisher = stack.enter_context(RobotPublisher(settings, _ROBOT, encoders))
        if heard:
            config = zenoh.Config.from_json5(
                f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}'
            )
            session = stack.enter_context(zenoh.open(config))
            session.declare_subscriber("**", lambda sample: received.append(len(sample.payload)))
            while not received:  # the first are lost: nobody is known to listen yet
                publisher.publish_pose(pose(0))
                time.sleep(_PERIOD_S)
        return measured(publisher.publish_pose, count)


def measured(act: Callable[[PoseMessage], object], count: int) -> str:
    """Median and p99 of ``act``."""
    took_s = []
    for seq in range(count):
        message = pose(seq)
        begun_s = time.perf_counter()
        act(message)
        took_s.append(time.perf_counter() - begun_s)
        time.sleep(_PERIOD_S)
    median, p99 = 1e6 * np.quantile(took_s, (0.5, 0.99))
    return f"{median:.0f} / {p99:.0f}"


if __name__ == "__main__":
    sys.exit(main())
