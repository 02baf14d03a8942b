"""A recorded run once more: the same poses, bit for bit, from its start and from its middle."""

from __future__ import annotations

import json
import signal
from collections import Counter, deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from daemon_rig import Daemon, Robot, until
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import lab

from amr_slam.cli import main
from amr_slam.engine import SlamEngine
from amr_slam.fusion import FilterParams
from amr_slam.fusion.ekf import Ekf
from amr_slam.geometry import Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.recording import Sample
from amr_slam.region import Region
from amr_slam.rerun import Decision, WitnessedLocalizer, rerun
from amr_slam.rerun.decisions import DRIVE, EKF, SNAPSHOT
from amr_slam.rerun.state import StateError, put_together, taken_apart
from amr_slam.samples import State
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    opposite_scanners,
    plan_tour,
)

PARAMS = SlamParams()
DRIVEN = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)


def driven(seconds: float) -> tuple[list[Sample], dict[str, Mounting]]:
    tour = plan_tour(lab(3))
    scanners = opposite_scanners(ScannerModel(sigma_range_m=0.01))
    robot = SimulatedRobot(
        world=lab(3), world_from_map=tour.world_from_map, scanners=scanners, seed=5
    )
    follower = PathFollower(tour.path_in_map_m)
    samples: list[Sample] = []
    while robot.stamp_ns < seconds * 1e9:
        samples += robot.advance(*follower.steer(robot.map_from_base))
    return samples, {s.name: Mounting(base_from_lidar=s.base_from_lidar) for s in scanners}


def fresh(kind: type[Localizer], mountings: dict[str, Mounting]) -> Any:
    return kind(LocalizerParams(), FilterParams(), PARAMS.clouds, DRIVEN, mountings, "mapping")


def test_from_any_snapshot_on_the_same_poses_follow() -> None:
    samples, mountings = driven(30.0)
    told: list[Decision | Sample] = []
    estimates: dict[int, Any] = {}
    live: WitnessedLocalizer = fresh(WitnessedLocalizer, mountings)
    live.witness(told.append, DRIVEN, 0.0)
    engine = SlamEngine(PARAMS, PointMap(PARAMS.map), "mapping")
    for number, sample in enumerate(samples):
        live.handle(sample)
        told.append(sample)
        request = live.take_request()
        if request is not None:
            if number % 3 == 0:
                live.drop_request()
            else:
                live.handle(engine.update(request))
        at = len(told)
        estimates[at] = live.estimate(sample.stamp_ns + 3_000_000)
    snapshots = [
        at for at, one in enumerate(told) if isinstance(one, Decision) and one.do == SNAPSHOT
    ]
    for begin in snapshots[1 : -100 : len(snapshots) // 6]:
        again: Localizer = fresh(Localizer, {})
        # By way of a file.
        state = json.loads(json.dumps(told[begin].arguments[0], allow_nan=False))  # type: ignore[union-attr]
        vars(again).update(put_together(state, {DRIVE: DRIVEN, EKF: Ekf(FilterParams())}))
        compared = 0
        for at, one in enumerate(told[begin:], begin):
            if not isinstance(one, Decision):
                again.handle(one)
            elif one.do == "answer":
                again.handle(put_together(json.loads(json.dumps(one.arguments[0])), {}))
            elif one.do == "estimate":
                made = again.estimate(one.arguments[0])
                was = estimates[at]
                assert made is not None
                assert made.map_from_base == was.map_from_base
                assert made.covariance.tobytes() == was.covariance.tobytes()
                assert (made.state, made.epoch, made.error95_m) == (
                    was.state,
                    was.epoch,
                    was.error95_m,
                )
                compared += 1
            elif one.do == "drop_request":
                again.drop_request()
            again.take_request()
        assert compared > 50


def replayed(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    status = main(["replay", str(path), "--as-recorded"])
    out = capsys.readouterr().out
    assert status == 0, out
    return out


@pytest.mark.timeout(300)
def test_an_incident_of_the_daemon_comes_out_as_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = tmp_path / "whole.mcap"
    with Robot(tmp_path) as robot, Daemon(tmp_path, record=whole) as daemon:
        daemon.listen()
        daemon.status_when(lambda s: s.state is State.MAPPING, "mapping")
        robot.front.unplug()
        daemon.status_when(lambda s: s.scanners["front"].link == "LOST", "front LOST")
        robot.front.replug()
        daemon.next_poses(200)
        daemon.process.send_signal(signal.SIGUSR1)
        until(lambda: "sigusr1.mcap: saved" in daemon.log(), "the recording")
        assert daemon.stop() == 0
    (saved,) = (tmp_path / "recordings").glob("*.mcap")
    for path in (whole, saved):
        result = rerun(path)
        assert result.poses > 200
        assert result.same == result.poses, result.first_difference
        assert result.answers > 2
        assert "bit for bit" in replayed(path, capsys)


def test_a_ring_that_began_in_the_middle_of_the_run_does_so_too(tmp_path: Path) -> None:
    with Robot(tmp_path), Daemon(tmp_path, ring_s=6.0) as daemon:
        daemon.listen()
        daemon.status_when(lambda s: s.state is State.MAPPING, "mapping")
        daemon.next_poses(600)
        daemon.process.send_signal(signal.SIGUSR1)
        until(lambda: "sigusr1.mcap: saved" in daemon.log(), "the recording")
        assert daemon.stop() == 0
    (saved,) = (tmp_path / "recordings").glob("*.mcap")
    result = rerun(saved)
    assert 100 < result.poses < 600
    assert result.same == result.poses, result.first_difference


# -- values ----------------------------------------------------------------------------------

plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=10)
    | st.sampled_from(State)
    | st.floats(allow_nan=False).map(np.float64)
    | st.integers(-100, 100).map(np.int64),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.tuples(inner, inner)
        | st.dictionaries(st.text(max_size=5), inner, max_size=4)
        | st.lists(inner, max_size=4).map(lambda items: deque(items, maxlen=5))
    ),
    max_leaves=20,
)


@settings(derandomize=True, deadline=None)
@given(plain)
def test_values_survive_to_the_bit(value: Any) -> None:
    again = put_together(json.loads(json.dumps(taken_apart(value, {}), allow_nan=False)), {})
    assert repr(again) == repr(value)


def test_shared_and_circular_objects_stay_shared() -> None:
    localizer = fresh(Localizer, {})
    both: list[Any] = [localizer, Counter(a=1)]
    both += [both[1], both]
    again = put_together(taken_apart(both, {DifferentialDrive: DRIVE}), {DRIVE: DRIVEN})
    assert again[1] is again[2]
    assert again[3] is again
    assert isinstance(again[0], Localizer)
    array = np.arange(6.0).reshape(2, 3)
    array.setflags(write=False)
    made = put_together(taken_apart(array, {}), {})
    np.testing.assert_array_equal(made, array)
    assert not made.flags.writeable


@pytest.mark.parametrize(
    "forged",
    [
        {"object": "os:system", "id": 0, "parts": {}},
        {"object": "amr_slam.service.usage:os", "id": 0, "parts": {}},
        {"object": "amr_slam.geometry:Pose2", "id": 0, "parts": {"__class__": 1}},
        {"object": "amr_slam.not_there:Pose2", "id": 0, "parts": {}},
        {"enum": "amr_slam.geometry:Pose2", "value": 1},
        {"array": "|O", "shape": [1], "data": "AAAAAAAAAAA=", "readonly": True},
        {"array": "<f8", "shape": [10**9], "data": "", "readonly": True},
        {"same": 7},
        {"known": "nobody"},
        {"unheard-of": 1},
        [1, 2],
    ],
)
def test_a_forged_state_makes_no_more_than_an_error(forged: Any) -> None:
    with pytest.raises(StateError):
        put_together(forged, {})


def test_what_no_recording_holds_is_refused() -> None:
    with pytest.raises(StateError, match="no kind"):
        taken_apart(Path("x"), {})
    region = Region(map_from_base=Pose2.identity(), radius_m=1.0, heading_rad=1.0)
    assert put_together(taken_apart(replace(region, radius_m=2.0), {}), {}).radius_m == 2.0
