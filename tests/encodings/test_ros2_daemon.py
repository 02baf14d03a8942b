"""A running daemon seen and told from ROS 2's side: a session that decodes with rosbags."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from daemon_rig import Daemon, Robot, until
from messages import pose_of
from ros2_bytes import deserialized, ros_pose, serialized
from test_commands import controlling, in_map, pose_when

from amr_slam.encodings.ros2.keys import DIAGNOSTICS, ODOMETRY, POSE, TRANSFORMS
from amr_slam.samples import State
from amr_slam.wire import PoseMessage

ROS2 = """
[ros2]
plain = true
rmw_zenoh = true
initialpose = true
"""
RMW_INITIALPOSE = f"0/amr7/initialpose/{POSE.dds_name}/RIHS01_{POSE.hash}"
KINDS = {"pose": POSE, "odom": ODOMETRY, "tf": TRANSFORMS, "diagnostics": DIAGNOSTICS}


class Heard:
    """The newest of each topic, decoded."""

    def __init__(self, session: zenoh.Session) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, Any] = {}
        self._subscribers = [
            session.declare_subscriber(f"amr7/{topic}", self._take) for topic in KINDS
        ]

    def _take(self, sample: zenoh.Sample) -> None:
        topic = str(sample.key_expr).removeprefix("amr7/")
        message = deserialized(KINDS[topic], sample.payload.to_bytes())
        with self._lock:
            self._newest[topic] = message

    def newest(self, topic: str) -> Any:
        with self._lock:
            return self._newest.get(topic)


def initialpose(near: PoseMessage, frame: str = "map", **changes: Any) -> bytes:
    """RViz's message: half a metre and 15 degrees of sigma."""
    planar = (0.25, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.068)
    about: dict[str, Any] = {
        "x": near.x + 0.4,
        "y": near.y - 0.3,
        "theta": near.theta,
        "covariance": planar,
    }
    return serialized(POSE, ros_pose(5, frame, pose_of(**(about | changes))))


def test_rviz_sees_the_robot_and_sets_its_pose_and_junk_does_not(tmp_path: Path) -> None:
    with Robot(tmp_path), Daemon(tmp_path, further=ROS2) as daemon:
        daemon.listen()
        with controlling(daemon) as controller:
            ros = controller.session
            heard = Heard(ros)
            daemon.status_when(in_map("hall", 15), "a map of a full turn")
            until(lambda: None not in [heard.newest(t) for t in KINDS], "all topics")
            assert heard.newest("pose").header.frame_id == "map"
            assert heard.newest("odom").child_frame_id == "base_footprint"
            assert "mapping" in heard.newest("diagnostics").status[0].message
            first = daemon.next_poses(1)[0]
            ros.put(RMW_INITIALPOSE, initialpose(first))
            daemon.status_when(lambda s: s.refused_requests == 1, "refused while mapping")

            controller.done("save_map", name="kept")
            controller.done("load_map", name="kept")
            here = pose_when(daemon, lambda p: p.state is State.LOCALIZED, "localized by itself")
            for key in ("amr7/initialpose", RMW_INITIALPOSE):
                before = daemon.next_poses(1)[0]
                ros.put(key, initialpose(before))
                pose = pose_when(
                    daemon, lambda p, b=before: p.epoch == b.epoch + 1, f"set over {key}"
                )
                assert np.hypot(pose.x - here.x, pose.y - here.y) < 0.2

            before = pose_when(daemon, lambda p: p.state is State.LOCALIZED, "localized")
            malformed = [
                b"junk",
                initialpose(before)[:-8],
                initialpose(before, frame="odom"),
                initialpose(before, x=99_000.0, covariance=(400.0, *(0.0,) * 8)),
            ]
            for payload in malformed:
                ros.put("amr7/initialpose", payload)
            told = daemon.status_when(lambda s: s.refused_requests >= 5, "all refused")
            assert told.refused_requests == 5
            after = daemon.next_poses(1)[0]
            assert after.epoch == before.epoch
            assert np.hypot(after.x - here.x, after.y - here.y) < 0.3
        log = daemon.log()
        assert "asked by ros2 initialpose" in log
        assert "ros2 initialpose: refused: in frame 'odom', not in 'map'" in log
        assert "Traceback" not in log
