"""Commands, scans and the map of a real daemon in front of emulated devices."""

from __future__ import annotations

import io
import itertools
import json
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import zenoh
from daemon_rig import ROBOT, Daemon, Robot, until

from amr_slam.map import load_map
from amr_slam.map.export import FREE, OCCUPIED
from amr_slam.map.file import decode
from amr_slam.samples import State
from amr_slam.wire import PoseMessage, StatusMessage

COMMAND_S = 90.0
LOCATED = {State.LOCALIZED, State.ODOMETRY_ONLY}


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with Robot(tmp_path) as robot:
        yield robot


class Controller:
    """Somebody on the network who shares no code with the robot."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session

    def get(self, key: str, payload: bytes | None = None) -> zenoh.Reply:
        replies = list(
            self.session.get(
                f"amr/{ROBOT}/{key}",
                payload=payload,
                timeout=COMMAND_S,
                priority=zenoh.Priority.DATA_LOW,
            )
        )
        assert len(replies) == 1, key
        return replies[0]

    def call(self, command: str, **arguments: Any) -> dict[str, Any]:
        return self.raw(command, json.dumps(arguments).encode())

    def raw(self, command: str, payload: bytes | None) -> dict[str, Any]:
        reply = self.get(f"cmd/{command}", payload)
        said = reply.ok or reply.err
        assert said is not None
        assert said.encoding == zenoh.Encoding.APPLICATION_JSON
        told: dict[str, Any] = json.loads(said.payload.to_bytes())
        assert told["ok"] is (told["error"] is None)
        return told

    def done(self, command: str, **arguments: Any) -> dict[str, Any]:
        told = self.call(command, **arguments)
        assert told["ok"], told
        return told

    def refused(self, command: str, **arguments: Any) -> str:
        told = self.call(command, **arguments)
        assert not told["ok"], told
        return str(told["error"])


@contextmanager
def controlling(daemon: Daemon) -> Iterator[Controller]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([daemon.endpoint]))
    with zenoh.open(config) as session:
        yield Controller(session)


def in_map(name: str, scans: int = 1) -> Any:
    def holds(status: StatusMessage) -> bool:
        return status.map is not None and status.map.name == name and status.map.version >= scans

    return holds


def pose_when(daemon: Daemon, condition: Any, what: str) -> PoseMessage:
    """The next pose for which ``condition`` holds."""
    found: list[PoseMessage] = []

    def looks() -> bool:
        found.extend(pose for pose in daemon.next_poses(1) if condition(pose))
        return bool(found)

    until(looks, what)
    return found[-1]


def none_was_late(poses: list[PoseMessage]) -> None:
    """By counting: none is missing in the sequence, and there are as many as their stamps need."""
    assert {b.seq - a.seq for a, b in itertools.pairwise(poses)} == {1}
    rate_hz = (len(poses) - 1) / (poses[-1].stamp - poses[0].stamp)
    assert rate_hz == pytest.approx(50.0, rel=0.25)


def test_from_a_new_map_over_saving_and_loading_to_every_way_of_setting_the_pose(
    robot: Robot, tmp_path: Path
) -> None:
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(in_map("hall"), "the first map")
        with controlling(daemon) as controller:
            daemon.waiting_poses()
            assert "while mapping" in controller.refused("set_pose", x=0, y=0, theta=0, radius=1)
            first = pose_when(daemon, lambda _: True, "a pose")

            told = controller.done("start_mapping", name="second")
            assert told["map"]["name"] == "second"
            assert len(load_map(tmp_path / "hall.amrmap")[0].path) >= 1  # kept
            pose = pose_when(daemon, lambda p: p.map == told["map"]["id"], "poses in the new map")
            assert pose.epoch == first.epoch + 1
            assert np.hypot(pose.x, pose.y) < 0.1
            status = daemon.status_when(in_map("second", 15), "a map of a full turn")
            assert status.mode == "mapping"

            told = controller.done("save_map", name="kept")
            assert told["file"] == "kept.amrmap"
            kept, kept_id = load_map(tmp_path / "kept.amrmap")
            assert (kept.name, str(kept_id)) == ("kept", told["map"]["id"])
            assert "kept already" in controller.refused("save_map", name="kept")
            assert "kept already" in controller.refused("start_mapping", name="kept")
            assert "cannot read the map" in controller.refused("load_map", name="nowhere")
            assert daemon.status_when(in_map("second"), "still mapping").mode == "mapping"

            told = controller.done("load_map", name="kept")
            assert told["map"]["id"] == str(kept_id)
            pose = pose_when(daemon, lambda p: p.map == str(kept_id), "poses in the loaded map")
            assert pose.epoch == first.epoch + 2
            assert pose.state not in LOCATED
            assert pose.error95_m > 100.0
            assert daemon.status_when(in_map("kept"), "loaded").mode == "localization"
            assert len(load_map(tmp_path / "second.amrmap")[0].path) >= 15
            here = pose_when(daemon, lambda p: p.state is State.LOCALIZED, "localized by itself")
            assert np.hypot(here.x, here.y) < 0.3

            about = {"x": here.x + 0.5, "y": here.y - 0.4, "theta": here.theta, "radius": 1.0}
            told = controller.done("set_pose", **about)
            pose = pose_when(daemon, lambda p: p.epoch == here.epoch + 1, "the pose is set")
            assert np.hypot(pose.x - here.x, pose.y - here.y) < 0.2
            assert np.hypot(told["pose"]["x"] - here.x, told["pose"]["y"] - here.y) < 0.2

            reason = controller.refused("set_pose", x=here.x + 3, y=here.y, theta=0, radius=0.5)
            assert reason.startswith("set_pose: ")
            assert len(reason) > len("set_pose: ")
            pose = pose_when(daemon, lambda p: p.state is State.LOCALIZED, "still localized")
            assert pose.epoch == here.epoch + 1
            assert np.hypot(pose.x - here.x, pose.y - here.y) < 0.2

            controller.done("resume_pose", x=pose.x, y=pose.y, theta=pose.theta)
            controller.done("relocalize")
            pose = pose_when(daemon, lambda p: p.epoch == here.epoch + 3, "forgotten")
            assert pose.state not in LOCATED
            pose = pose_when(daemon, lambda p: p.state is State.LOCALIZED, "found again")
            assert pose.epoch == here.epoch + 4
            assert np.hypot(pose.x - here.x, pose.y - here.y) < 0.2

            # A version of the map that is active, in the same frame: the pose is still true.
            controller.done("load_map", name="kept")
            again = pose_when(daemon, lambda p: p.epoch == here.epoch + 5, "the map, once more")
            assert np.hypot(again.x - here.x, again.y - here.y) < 0.2
            assert again.state is not State.LOST
            assert again.error95_m < 1.0
            refused = controller.refused("start_mapping", name="second", extend=True)
            assert "load_map first" in refused
            pose_when(daemon, lambda p: p.state is State.LOCALIZED, "a scan agrees")
            controller.done("start_mapping", name="kept", extend=True)
            pose = pose_when(daemon, lambda p: p.state is State.MAPPING, "the map grows on")
            assert pose.epoch == again.epoch
            assert np.hypot(pose.x - here.x, pose.y - here.y) < 0.2
        assert 'command load_map {"name":"kept"}, asked by ' in daemon.log()
        assert "Traceback" not in daemon.log()
        assert daemon.stop() == 0


def test_no_command_makes_a_pose_late(robot: Robot, tmp_path: Path) -> None:
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(in_map("hall", 2), "a map")
        with controlling(daemon) as controller:
            daemon.waiting_poses()
            controller.get("map")
            controller.get("map/image?resolution=0.01")
            controller.done("save_map", name="a")
            told = controller.done("save_recording", reason="odd")
            controller.done("start_mapping", name="b")
            controller.done("load_map", name="a")
            none_was_late(daemon.waiting_poses())
            until(lambda: any((tmp_path / "recordings").glob("*-odd.mcap")), "the recording")
            (saved,) = (tmp_path / "recordings").glob("*-odd.mcap")
            assert saved.name == told["file"]
            assert saved.stat().st_size > 10_000
        assert daemon.stop() == 0


def test_what_is_no_command_is_refused_by_one_line_and_changes_nothing(
    robot: Robot, tmp_path: Path
) -> None:
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(in_map("hall"), "a map")
        with controlling(daemon) as controller:
            for command, payload, error in (
                ("dance", b"{}", "dance: no such command"),
                ("start_mapping", b"{", "JSON"),
                ("start_mapping", b"\xff\xfe", ""),
                ("start_mapping", None, "name"),
                ("start_mapping", b'{"name": "../etc/passwd"}', "should be 1 to 64"),
                ("load_map", b'{"name": "hall.amrmap/x"}', "should be 1 to 64"),
                ("load_map", b'{"name": ".."}', "should be 1 to 64"),
                ("set_pose", b'{"x": 1, "y": 2, "theta": 3}', "radius"),
                ("set_pose", b'{"x": NaN, "y": 2, "theta": 3, "radius": 1}', "x"),
                ("set_pose", b'{"x": 1, "y": 2, "theta": 3, "radius": -1}', "radius"),
                ("set_pose", b'{"x": "1", "y": 2, "theta": 3, "radius": 1}', "x"),
                ("relocalize", b'{"really": true}', "really"),
                ("save_recording", b'{"reason": "a b"}', "should be 1 to 40"),
                ("load_map", b" " * 5000, "5000 bytes, at most 4096"),
                ("load_map", bytes(3_000_000), None),
            ):
                if error is None:  # beyond what the session takes in at all
                    assert not any(
                        reply.ok and json.loads(reply.ok.payload.to_bytes())["ok"]
                        for reply in controller.session.get(
                            f"amr/{ROBOT}/cmd/{command}", payload=payload, timeout=3.0
                        )
                    )
                    continue
                told = controller.raw(command, payload)
                assert not told["ok"]
                assert error in told["error"], told
                assert "\n" not in told["error"]
        with controlling(daemon) as controller:  # the robot is still there for others
            told = controller.raw("*", b"{}")
            assert "one robot, by its full key" in told["error"]
            for reply in controller.session.get(
                "amr/*/cmd/relocalize", payload=b"{}", timeout=COMMAND_S
            ):
                assert reply.err is not None
            status = daemon.status_when(in_map("hall"), "the same map")
        assert status.mode == "mapping"
        assert {path.name for path in tmp_path.glob("*.amrmap")} <= {"hall.amrmap"}
        assert daemon.stop() == 0


def test_one_command_at_a_time_and_not_too_many(robot: Robot, tmp_path: Path) -> None:
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(in_map("hall"), "a map")
        told: list[str | None] = []
        with controlling(daemon) as controller:
            crowd = [
                threading.Thread(
                    target=lambda n=n: told.append(
                        controller.call("save_map", name=f"copy{n}")["error"]
                    )
                )
                for n in range(24)
            ]
            for one in crowd:
                one.start()
            for one in crowd:
                one.join()
        assert len(told) == 24
        assert None in told
        refusals = {error for error in told if error is not None}
        assert refusals <= {
            "another command is under way",
            "too many commands: 2 a second is enough",
        }
        assert "too many commands: 2 a second is enough" in refusals
        assert len(list(tmp_path.glob("copy*.amrmap"))) == told.count(None)
        assert daemon.stop() == 0


def test_the_map_its_picture_and_the_scans_fit_together(robot: Robot, tmp_path: Path) -> None:
    scans: list[dict[str, Any]] = []
    with Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(in_map("hall", 5), "a map")
        with controlling(daemon) as controller:
            reply = controller.get("map").ok
            assert reply is not None
            assert reply.priority == zenoh.Priority.DATA_LOW  # as it was asked for
            assert reply.congestion_control == zenoh.CongestionControl.BLOCK
            assert reply.attachment is not None
            known, map_id = decode(reply.payload.to_bytes())
            assert json.loads(reply.attachment.to_bytes()) == {"v": 1, "map": str(map_id)}
            assert len(known.path) >= 5

            reply = controller.get("map/image?resolution=0.05").ok
            assert reply is not None
            assert reply.encoding == zenoh.Encoding.IMAGE_PNG
            assert reply.attachment is not None
            about = json.loads(reply.attachment.to_bytes())
            pixels = matplotlib.image.imread(io.BytesIO(reply.payload.to_bytes()), format="png")
            pixels = np.round(255.0 * pixels)
            assert pixels.shape == (about["height_px"], about["width_px"])
            assert about["metres_per_px"] == 0.05
            at = np.array([about["column_of_x0_px"], about["row_of_y0_px"]])

            def grey(points_m: Any) -> Any:
                column, row = np.floor(at + points_m / 0.05 * [1.0, -1.0]).astype(int).T
                return pixels[row, column]

            assert np.mean(grey(known.target().points_m - 1e-6) == OCCUPIED) > 0.95
            turns = np.linspace(-3.0, 3.0, 30)
            around = 0.7 * np.column_stack([np.cos(turns), np.sin(turns)])
            assert np.mean(grey(around) == FREE) > 0.7  # where the robot stands

            controller.session.declare_subscriber(
                f"amr/{ROBOT}/scan",
                lambda sample: scans.append(
                    json.loads(sample.payload.to_bytes())
                    | {"dropped": sample.congestion_control == zenoh.CongestionControl.DROP}
                ),
            )
            until(lambda: len(scans) >= 3, "scans")
            pose = daemon.next_poses(1)[0]
            scan = scans[-1]
            assert (scan["robot"], scan["map"], scan["epoch"]) == (ROBOT, pose.map, pose.epoch)
            assert scan["dropped"]
            points = np.array(scan["points"])
            assert 50 <= len(points) <= 360
            near = [np.hypot(*(known.target().points_m - p).T).min() < 0.1 for p in points]
            assert np.mean(near) > 0.8
            for bad in ("map/image?resolution=nan", "map/image?resolution=-1"):
                refused = controller.get(bad)
                assert refused.err is not None
                assert "resolution" in refused.err.payload.to_string()
        assert daemon.stop() == 0


def test_a_command_is_answered_when_the_slam_process_dies(robot: Robot, tmp_path: Path) -> None:
    with Daemon(tmp_path, save_period_s=5.0) as daemon:
        daemon.listen()
        daemon.status_when(in_map("hall"), "a map")
        until(lambda: "saved to" in daemon.log(), "the first save")
        first = daemon.slam_process()
        os.kill(first, signal.SIGSTOP)
        told: list[dict[str, Any]] = []
        with controlling(daemon) as controller:
            asking = threading.Thread(
                target=lambda: told.append(controller.call("save_map", name="copy"))
            )
            asking.start()
            until(lambda: "command save_map" in daemon.log(), "the command is under way")
            os.kill(first, signal.SIGKILL)
            asking.join()
            # It had begun, or waited for the next process.
            assert told[0]["ok"] or "the SLAM process has ended" in told[0]["error"]
            daemon.status_when(lambda s: s.slam.link == "OK", "a new process")
            assert controller.done("save_map", name="copy2")["file"] == "copy2.amrmap"
        none_was_late(daemon.waiting_poses())
        assert daemon.stop() == 0
