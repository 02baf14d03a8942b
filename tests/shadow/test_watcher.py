"""Two systems' poses, paired and counted on a clock of the test's own."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_drives import drive
from messages import MAP_ID, pose_of

from amr_slam.aligning import FitParams, fit_pairs, read_pairs
from amr_slam.geometry import Pose2
from amr_slam.samples import State
from amr_slam.shadow import FrameSettings, Shadow, ShadowSettings
from amr_slam.shadow.comparison import Comparison
from amr_slam.wire import ShadowPart

START_S = 1_790_000_000.0
LATE_S = 0.08
KEY = "cameras/amr7/pose"
NOWHERE_ELSE = Pose2.identity()


class Idle(Shadow):
    """Without its thread: the test turns it, on its own clock."""

    def _run(self) -> None:
        pass


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Any]:
    open_ones: list[Idle] = []

    def make(**settings: Any) -> Idle:
        given: dict[str, Any] = {"key": KEY, "directory": tmp_path} | settings
        open_ones.append(Idle(ShadowSettings(**given), "amr7"))
        return open_ones[-1]

    yield make
    for shadow in open_ones:
        shadow.close()
        shadow._file.close()


def hear(shadow: Idle, now_s: float, message: dict[str, Any] | bytes) -> None:
    payload = message if isinstance(message, bytes) else json.dumps(message).encode()
    shadow._payloads.append((payload, now_s))


def run(
    shadow: Idle,
    camera_from_map: Pose2 = NOWHERE_ELSE,
    marker: Pose2 = NOWHERE_ELSE,
    *,
    clock_s: float = 0.0,
    headings: bool = True,
    swapped: float = 0.0,
) -> ShadowPart:
    """The simulated drive: the robot says where it is, the cameras see it 80 ms later and stamp
    it then. ``clock_s``: on the robot's clock it is so much later than on theirs."""
    rng = np.random.default_rng(0)
    known = drive()
    times = START_S + 1e-9 * known.stamps_ns
    steps = np.diff(known.poses[:, 2], prepend=known.poses[0, 2])
    omegas = np.mod(steps + math.pi, math.tau) - math.pi
    speeds = np.hypot(*np.diff(known.poses[:, :2], prepend=known.poses[:1, :2], axis=0).T)
    for row, (stamp_s, pose) in enumerate(zip(times.tolist(), known.poses.tolist(), strict=True)):
        said = pose_of(
            seq=row, stamp=stamp_s, x=pose[0], y=pose[1], theta=pose[2],
            omega=float(omegas[row]) / 0.02, vx=float(speeds[row]) / 0.02,
        )  # fmt: skip
        shadow.said(said)
        if row % 2 == 0 and row >= 4:
            then = known.poses[row - 4] if rng.random() >= swapped else known.poses[row - 900]
            seen = camera_from_map @ Pose2.from_array(then) @ marker
            x_m, y_m = (seen.translation + rng.normal(0.0, 0.01, 2)).tolist()
            message = {"x": x_m, "y": y_m, "stamp": stamp_s - clock_s}
            if headings:
                message["theta"] = seen.theta_rad + rng.normal(0.0, math.radians(0.5))
            hear(shadow, stamp_s, message)
        if row % 3 == 0:
            shadow.turn(stamp_s)
    shadow.turn(times[-1] + 1.0)
    return shadow.part()


@pytest.mark.parametrize("headings", [True, False])
def test_two_systems_that_agree(made: Any, headings: bool) -> None:
    part = run(made(theta="theta" if headings else ""), headings=headings)
    # 80 ms late is found from the turns, or from the way ahead.
    assert part.clock_sigma_s is not None
    assert part.clock_s == pytest.approx(-LATE_S, abs=0.02)
    assert part.received == pytest.approx(4170, abs=10)
    assert part.count > 3000  # since the clock difference is known
    assert part.refused == part.unmatched == part.dropped == 0
    assert part.rms_m == pytest.approx(0.0142, abs=0.001)
    assert part.p95_m == pytest.approx(0.0245, rel=0.15)
    assert part.mean_m < part.rms_m < part.p95_m < part.max_m < 0.08
    assert abs(part.bias_x_m) + abs(part.bias_y_m) < 0.003
    assert (part.rms_rad is not None) is headings
    assert 1 <= len(part.zones) <= 5
    assert part.zones[0].rms_m >= part.zones[-1].rms_m


def test_a_heading_s_bias_is_the_mean_over_those_that_tell_one() -> None:
    comparison = Comparison("a map", 0.0, 5.0)
    for turn in (0.1, None, 0.3, None):
        comparison.add(1.0, 2.0, (0.02, -0.04, turn))
    assert comparison.bias == pytest.approx((0.02, -0.04, 0.2))


def test_clocks_of_different_times_are_brought_together(made: Any) -> None:
    part = run(made(), clock_s=5000.0)
    assert part.clock_s == pytest.approx(5000.0 - LATE_S, abs=0.02)
    assert part.rms_m == pytest.approx(0.0142, abs=0.001)


def test_a_clock_difference_that_is_given_is_used(made: Any) -> None:
    part = run(made(clock_s=-LATE_S))
    assert part.clock_s == -LATE_S
    assert part.clock_sigma_s == 0.0
    assert part.rms_m == pytest.approx(0.01 * math.sqrt(2.0), rel=0.05)


def test_frame_and_marker_as_configured(made: Any) -> None:
    frame = FrameSettings(x_m=3.0, y_m=-1.0, theta_deg=30.0)
    marker = FrameSettings(x_m=0.11, y_m=-0.05, theta_deg=3.0)
    shadow = made(map_from_camera=frame, base_from_marker=marker, clock_s=-LATE_S)
    part = run(shadow, frame.pose.inverse(), marker.pose)
    assert part.rms_m == pytest.approx(0.01 * math.sqrt(2.0), rel=0.05)
    assert part.bias_rad == pytest.approx(0.0, abs=0.001)


def test_the_table_brings_the_map_into_the_cameras_frame(made: Any, tmp_path: Path) -> None:
    """The cameras' frame is not known yet, their clock is off, the marker anywhere."""
    camera_from_map, marker = Pose2(12.3, -4.5, math.radians(40.0)), Pose2(0.11, -0.05, 0.05)
    shadow = made(file_period_s=0.2)
    part = run(shadow, camera_from_map, marker, swapped=0.02)
    assert part.clock_s == pytest.approx(-LATE_S, abs=0.02)  # by the turns alone
    assert part.mean_m > 5.0
    shadow._file.close()
    pairs = read_pairs(tmp_path / "amr7-shadow.csv", MAP_ID)
    assert len(pairs) == pytest.approx(834, abs=20)  # five a second
    fit = fit_pairs(pairs, FitParams())
    assert fit.problems == ()
    assert fit.site_from_map.distance_to(camera_from_map) < 0.01
    assert abs((fit.site_from_map.inverse() @ camera_from_map).theta_rad) < math.radians(0.05)
    assert fit.base_from_marker.distance_to(marker) < 0.006
    assert 5 <= int((~fit.agrees).sum()) <= 40


def test_poses_that_are_not_to_be_driven_by_are_not_compared(made: Any) -> None:
    shadow = made(clock_s=0.0)
    for step in range(20):
        shadow.said(pose_of(seq=step, stamp=START_S + 0.02 * step, state=State.LOST))
    hear(shadow, START_S, {"x": 0.0, "y": 0.0, "theta": 0.0, "stamp": START_S + 0.1})
    shadow.turn(START_S + 1.0)
    part = shadow.part()
    assert (part.count, part.unlocalized) == (0, 1)


def test_a_pose_waits_for_the_robot_s_own_and_is_not_compared_across_a_jump(made: Any) -> None:
    shadow = made(clock_s=0.0)
    camera = {"x": 1.0, "y": 2.0, "theta": 0.0}

    def say(seq: int, epoch: int = 0, x: float = 1.0) -> None:
        stamp = START_S + 0.02 * seq
        shadow.said(pose_of(seq=seq, stamp=stamp, epoch=epoch, x=x, y=2.0, theta=0.0))

    say(0)
    hear(shadow, START_S, camera | {"stamp": START_S + 0.03})
    shadow.turn(START_S + 0.1)
    assert shadow._waiting
    say(1)
    say(2)
    shadow.turn(START_S + 0.4)
    assert shadow.part().count == 1
    say(3, epoch=1, x=9.0)
    hear(shadow, START_S + 0.4, camera | {"stamp": START_S + 0.05})
    shadow.turn(START_S + 0.8)
    assert (shadow.part().count, shadow.part().unmatched) == (1, 1)
    # Stamped when nothing of the robot is known: long ago, and where it never comes.
    hear(shadow, START_S + 1.0, camera | {"stamp": START_S - 60.0})
    hear(shadow, START_S + 1.0, camera | {"stamp": START_S + 1.5})
    shadow.turn(START_S + 1.5)
    assert shadow.part().unmatched == 2
    shadow.turn(START_S + 3.5)
    assert shadow.part().unmatched == 3
    assert shadow.part().detail is not None


def test_another_map_begins_anew(made: Any) -> None:
    shadow = made(clock_s=0.0)
    for seq, map_id in enumerate([MAP_ID] * 3 + ["0" * 36] * 3):
        shadow.said(pose_of(seq=seq, stamp=START_S + 0.02 * seq, map=map_id, epoch=seq // 3))
    for seq in (1, 4):
        pose = {"x": 1.5, "y": -2.25, "theta": 0.5, "stamp": START_S + 0.02 * seq}
        hear(shadow, START_S, pose)
    shadow.turn(START_S + 1.0)
    assert shadow.part().count == 1
    assert shadow.part().since == START_S + 0.08


def test_floods_and_nonsense_are_bounded_and_told_once_a_minute(
    made: Any, caplog: pytest.LogCaptureFixture
) -> None:
    shadow = made()
    for _ in range(5000):
        shadow.heard(b"\x1b[2J nonsense")
    shadow.turn(START_S)
    part = shadow.part()
    assert part.received == 512  # the queue's length
    assert part.refused <= 201 + 200
    assert part.refused + part.dropped == 512
    told = [record for record in caplog.records if "shadow" in record.getMessage()]
    assert len(told) == 1
    assert "\x1b" not in told[0].getMessage()


def test_full_files_roll_and_broken_ones_are_set_aside(made: Any, tmp_path: Path) -> None:
    (tmp_path / "amr7-shadow.csv").write_text("something else\n")
    shadow = made(file_mb=0.05, file_period_s=0.0, clock_s=-LATE_S)
    run(shadow)
    shadow._file.close()
    new, old = tmp_path / "amr7-shadow.csv", tmp_path / "amr7-shadow.1.csv"
    assert 0 < new.stat().st_size < 60_000
    assert 49_000 < old.stat().st_size < 60_000
    for path in (new, old):
        assert len(read_pairs(path)) > 10
    assert sorted(path.name for path in tmp_path.iterdir()) == [old.name, new.name]


def test_a_table_goes_on_after_a_restart(made: Any, tmp_path: Path) -> None:
    for begin_s in (START_S, START_S + 100.0):
        shadow = made(clock_s=0.0)
        for seq in range(10):
            shadow.said(pose_of(seq=seq, stamp=begin_s + 0.02 * seq))
        hear(shadow, begin_s, {"x": 1.5, "y": -2.25, "theta": 0.5, "stamp": begin_s + 0.1})
        shadow.turn(begin_s + 1.0)
        shadow._file.close()
    assert len(read_pairs(tmp_path / "amr7-shadow.csv")) == 2


def test_a_disk_that_refuses_stops_nothing(
    made: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    part = run(made(directory=tmp_path / "file" / "below"))
    assert part.count > 3000
    assert sum("cannot be written" in record.getMessage() for record in caplog.records) == 1
