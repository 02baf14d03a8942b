"""The daemon killed at random moments: it localizes where it was, or where it has been brought."""

from __future__ import annotations

import itertools
import random
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from daemon_rig import Daemon, Robot, until

from amr_slam.geometry import Pose2, wrap_angle
from amr_slam.map import load_map
from amr_slam.samples import State
from amr_slam.service.last_pose import clocks_ns, decode, encode
from amr_slam.wire import PoseMessage

WHERE = "localized where the last run left off"
ELSEWHERE = "not where the last run left off"


def hint_of(folder: Path) -> Path:
    return folder / "amr7.lastpose"


def mapped(folder: Path, scans: int = 4) -> None:
    with Daemon(folder) as daemon:
        daemon.listen()
        daemon.status_when(
            lambda s: s.state is State.MAPPING and s.map is not None and s.map.version >= scans,
            "a map",
        )
        assert daemon.stop() == 0
    # A run that ends by itself leaves nothing to go on with.
    assert not hint_of(folder).exists()


def localized(daemon: Daemon) -> PoseMessage:
    daemon.listen()
    daemon.status_when(lambda s: s.state is State.LOCALIZED, "localized")
    return next(p for p in daemon.next_poses(200) if p.state is State.LOCALIZED)


def map_from_world_rad(robot: Robot, pose: PoseMessage) -> float:
    return wrap_angle(pose.theta - robot._robot.map_from_base.theta_rad)


@pytest.mark.timeout(300)
def test_killed_at_any_moment_it_is_found_again_where_it_was_or_where_it_is(tmp_path: Path) -> None:
    moments = random.Random(7)
    with Robot(tmp_path) as robot:
        mapped(tmp_path)
        robot.turn_radps = 0.0  # nobody drives without poses
        before: PoseMessage | None = None
        for _ in range(3):
            with Daemon(tmp_path, localize=True) as daemon:
                pose = localized(daemon)
                if before is not None:
                    until(lambda: WHERE in daemon.log(), "that it is where it was")
                    assert pose.map == before.map
                    assert abs(pose.x - before.x) < 0.1
                    assert abs(pose.y - before.y) < 0.1
                until(hint_of(tmp_path).exists, "the last pose on disk")
                poses = daemon.next_poses(1 + round(100 * moments.random()))
                before = poses[-1]
                turned = map_from_world_rad(robot, before)
                assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
        assert before is not None
        # As if somebody had turned the robot round meanwhile.
        last = decode(hint_of(tmp_path).read_bytes())
        uptime_ns, utc_ns = clocks_ns()
        pose_then = last.map_from_base
        round_it = Pose2(pose_then.x_m, pose_then.y_m, wrap_angle(pose_then.theta_rad + 3.14))
        moved = replace(last, map_from_base=round_it, uptime_ns=uptime_ns, utc_ns=utc_ns)
        hint_of(tmp_path).write_bytes(encode(moved))
        with Daemon(tmp_path, localize=True) as daemon:
            pose = localized(daemon)
            until(lambda: ELSEWHERE in daemon.log(), "that it is elsewhere")
            assert abs(wrap_angle(map_from_world_rad(robot, pose) - turned)) < 0.3
            assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
        hint_of(tmp_path).write_bytes(hint_of(tmp_path).read_bytes()[:-7])
        with Daemon(tmp_path, localize=True) as daemon:
            pose = localized(daemon)
            assert "no last pose to begin at: the file is damaged" in daemon.log()
            assert abs(wrap_angle(map_from_world_rad(robot, pose) - turned)) < 0.3
            assert daemon.stop() == 0


@pytest.mark.timeout(300)
def test_mapping_that_was_cut_off_goes_on_in_the_same_map(tmp_path: Path) -> None:
    with Robot(tmp_path):
        with Daemon(tmp_path, save_period_s=5.0) as daemon:
            daemon.listen()
            daemon.status_when(
                lambda s: s.state is State.MAPPING and s.map is not None and s.map.version >= 3,
                "a map",
            )
            until(lambda: "saved to" in daemon.log(), "the first save")
            until(hint_of(tmp_path).exists, "the last pose on disk")
            assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
        scans = len(load_map(daemon.map_path)[0].path)
        with Daemon(tmp_path) as daemon:
            daemon.listen()
            status = daemon.status_when(
                lambda s: s.state is State.MAPPING and s.map is not None, "mapping goes on"
            )
            assert "mapping was cut off" in daemon.log()
            assert "mapping goes on in" in daemon.log()
            daemon.status_when(
                lambda s: s.map is not None and s.map.version > scans and s.fault is None,
                "the map grows",
            )
            assert status.mode == "mapping"
            poses = daemon.next_poses(50)
            assert {b.seq - a.seq for a, b in itertools.pairwise(poses)} == {1}
            assert daemon.stop() == 0
        grown, _ = load_map(daemon.map_path)
        assert len(grown.path) > scans
        # The pose graph goes on too: each scan is tied to the one before, new ones as well.
        ties = grown.ties
        steps = ties.ends[~ties.loops & (ties.ends == ties.starts + 1)]
        assert len(steps) == len(grown.path) - 1
        # It is one map, not a new one beside the old.
        assert not daemon.map_path.with_name("hall.amrmap.1").exists()


def test_a_map_that_cannot_be_saved_is_told_and_nothing_else_suffers(tmp_path: Path) -> None:
    in_the_way = tmp_path / "hall.amrmap"
    in_the_way.mkdir()
    with Robot(tmp_path), Daemon(tmp_path, save_period_s=5.0) as daemon:
        daemon.listen()
        status = daemon.status_when(
            lambda s: "cannot write the map" in (s.fault or "") and s.state is State.MAPPING,
            "the fault",
        )
        assert status.slam.link == "OK"
        assert "cannot write the map" in (status.slam.detail or "")
        poses = daemon.next_poses(50)
        assert all("cannot write the map" in (pose.fault or "") for pose in poses[10:])
        assert {b.seq - a.seq for a, b in itertools.pairwise(poses)} == {1}
        in_the_way.rmdir()
        daemon.status_when(lambda s: s.fault is None, "the fault's end")
        assert daemon.stop() == 0
    assert len(load_map(daemon.map_path)[0].path) >= 1
