"""A running daemon seen and told from ROS 2's side: a session that decodes with rosbags."""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
import zenoh.ext
from daemon_rig import Daemon, Robot, until
from messages import pose_of
from ros2_bytes import deserialized, ros_pose, serialized
from test_commands import controlling, pose_when

from amr_slam.clouds import cloud_from_scan
from amr_slam.encodings.ros2.keys import DIAGNOSTICS, GRID, ODOMETRY, POSE, TRANSFORMS
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap, save_map
from amr_slam.params import SlamParams
from amr_slam.samples import State
from amr_slam.simulation import ScannerModel, laboratory, plan_tour, take_scan
from amr_slam.wire import PoseMessage

ROS2 = """
[ros2]
plain = true
rmw_zenoh = true
initialpose = true
"""
RMW_INITIALPOSE = f"0/amr7/initialpose/{POSE.dds_name}/RIHS01_{POSE.hash}"
KINDS = {"pose": POSE, "odom": ODOMETRY, "tf": TRANSFORMS, "diagnostics": DIAGNOSTICS}
RMW_MAP = f"0/amr7/map/{GRID.dds_name}/RIHS01_{GRID.hash}"


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

    def take_map(self, sample: zenoh.Sample) -> None:
        message = deserialized(GRID, sample.payload.to_bytes())
        with self._lock:
            self._newest["map"] = message

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


def place_as_mapped(path: Path) -> None:
    """What :class:`Robot` sees around its start, from true poses: a map to start with."""
    world, params, rng = laboratory(3), SlamParams(), np.random.default_rng(0)
    world_from_map, scanner = plan_tour(world).world_from_map, ScannerModel(sigma_range_m=0.01)
    grown = PointMap(params.map)
    for theta_rad in np.linspace(-np.pi, np.pi, 12, endpoint=False):
        pose = Pose2(0.0, 0.0, float(theta_rad))
        scan = take_scan(scanner, world, world_from_map @ pose, rng)
        grown.insert(cloud_from_scan(scan, Pose2.identity(), params.clouds), pose)
    save_map(grown, path)


def has_set(daemon: Daemon, times: int) -> bool:
    return daemon.log().count("set_pose: done") == times


def test_rviz_sees_the_robot_and_sets_its_pose_and_junk_does_not(tmp_path: Path) -> None:
    place_as_mapped(tmp_path / "place.amrmap")

    def edit(text: str) -> str:
        wanted = f'mode = "localization"\npath = "{tmp_path}/place.amrmap"'
        return text.replace('mode = "mapping"', wanted) + ROS2

    with Robot(tmp_path), Daemon(tmp_path, edit=edit) as daemon:
        daemon.listen()
        with controlling(daemon) as controller:
            ros = controller.session
            heard = Heard(ros)
            here = pose_when(daemon, lambda p: p.state is State.LOCALIZED, "localized by itself")
            assert np.hypot(here.x, here.y) < 0.2
            until(lambda: None not in [heard.newest(t) for t in KINDS], "all topics")
            late = zenoh.ext.declare_advanced_subscriber(
                ros,
                RMW_MAP,
                heard.take_map,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
            )
            until(lambda: heard.newest("map") is not None, "the map, though it was told before")
            late.undeclare()  # type: ignore[no-untyped-call]
            grid = heard.newest("map")
            cells = grid.data.reshape(grid.info.height, grid.info.width)
            low = np.array([grid.info.origin.position.x, grid.info.origin.position.y])
            column, row = ((np.array([here.x, here.y]) - low) / grid.info.resolution).astype(int)
            assert cells[row, column] == 0  # the robot stands on free floor
            assert 100 in cells
            seen = heard.newest("pose")
            assert seen.header.frame_id == "map"
            assert np.hypot(seen.pose.pose.position.x, seen.pose.pose.position.y) < 0.2
            assert heard.newest("odom").child_frame_id == "base_footprint"
            assert len(heard.newest("tf").transforms) == 2
            for count, key in enumerate(("amr7/initialpose", RMW_INITIALPOSE), start=1):
                before = daemon.next_poses(1)[0]
                ros.put(key, initialpose(before))
                pose = pose_when(
                    daemon, lambda p, b=before: p.epoch == b.epoch + 1, f"set over {key}"
                )
                assert np.hypot(pose.x - here.x, pose.y - here.y) < 0.2
                until(partial(has_set, daemon, count), "the place is free again")

            before = pose_when(daemon, lambda p: p.state is State.LOCALIZED, "localized")
            malformed = [
                b"junk",
                initialpose(before)[:-8],
                initialpose(before, frame="odom"),
                initialpose(before, x=99_000.0, covariance=(400.0, *(0.0,) * 8)),
            ]
            for payload in malformed:
                ros.put("amr7/initialpose", payload)
            told = daemon.status_when(lambda s: s.refused_requests >= 4, "all refused")
            assert told.refused_requests == 4
            after = daemon.next_poses(1)[0]
            assert after.epoch == before.epoch
            assert np.hypot(after.x - here.x, after.y - here.y) < 0.3
        assert daemon.stop() == 0  # nothing of ROS 2 is left open
        log = daemon.log()
        assert "asked by ros2 initialpose" in log
        assert "ros2 initialpose: refused: in frame 'odom', not in 'map'" in log
        assert "Traceback" not in log
