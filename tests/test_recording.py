from __future__ import annotations

import gzip
import math
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from paths import SHARED

from amr_slam.geometry import Pose2
from amr_slam.recording import (
    Log,
    RecordingError,
    RecordingWriter,
    Sample,
    Trajectory,
    read_log,
    read_relations,
    read_tum,
    write_tum,
)
from amr_slam.recording.messages import Entry
from amr_slam.samples import JointSample, OdometrySample, Scan, WheelSample

LOGS = SHARED / "data" / "logs"
needs_logs = pytest.mark.skipif(not LOGS.is_dir(), reason="public robot logs are not here")
fixed = settings(
    derandomize=True,
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)

ODOM = "ODOM 1.5 -2.0 0.5 0.3 0.1 0 12.000000001 robot 12.1"
RANGES = [f"{1 + 0.01 * i:.2f}" for i in range(180)]
FLASER = f"FLASER 180 {' '.join(RANGES)} 1 2 0.3 1.5 -2.0 0.5 12.5 robot 12.6"
ROBOTLASER = (
    "ROBOTLASER1 0 -0.5 1.0 0.25 30.0 0.01 0 5 1.0 30.0 -1 nan 2.5 2 7 8 "
    "9 9 9 1.5 -2.0 0.5 0.1 0.2 0 0 0 13.25 robot 13.3"
)
CARMEN = f"# a comment\n{FLASER}\nPARAM laser on\n\n{ODOM}\n{ROBOTLASER}\n"


def log_of(tmp_path: Path, text: str | bytes, name: str = "run.log") -> Log:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_log(path)


def same(a: Sample, b: Sample) -> bool:
    if not (isinstance(a, Scan) and isinstance(b, Scan)):
        return a == b
    return np.array_equal(a.ranges_m, b.ranges_m, equal_nan=True) and all(
        getattr(a, name) == getattr(b, name) for name in Scan.__slots__ if name != "ranges_m"
    )


def same_log(a: Log, b: Log) -> bool:
    if (a.truth is None) != (b.truth is None) or len(a.samples) != len(b.samples):
        return False
    if a.truth is not None and b.truth is not None:
        if not np.array_equal(a.truth.stamps_ns, b.truth.stamps_ns):
            return False
        if not np.array_equal(a.truth.poses, b.truth.poses):
            return False
    return all(same(x, y) for x, y in zip(a.samples, b.samples, strict=True))


def test_carmen_messages_become_samples_in_the_order_of_time(tmp_path: Path) -> None:
    odometry, front, laser = log_of(tmp_path, CARMEN).samples
    assert odometry == OdometrySample(stamp_ns=12_000_000_001, odom_from_base=Pose2(1.5, -2.0, 0.5))
    assert isinstance(front, Scan)
    assert isinstance(laser, Scan)
    assert (front.scanner, front.stamp_ns, front.range_max_m) == ("flaser", 12_500_000_000, 81.83)
    assert front.angle_min_rad == -math.pi / 2
    assert front.angle_step_rad == math.radians(1.0)
    np.testing.assert_array_equal(front.ranges_m, [float(r) for r in RANGES])
    assert (laser.scanner, laser.stamp_ns, laser.range_max_m) == ("robotlaser1", 13_250_000_000, 30)
    assert (laser.angle_min_rad, laser.angle_step_rad) == (-0.5, 0.25)
    np.testing.assert_array_equal(laser.ranges_m, [1.0, math.inf, math.nan, math.nan, 2.5])


@pytest.mark.parametrize(("beams", "step_deg"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5)])
def test_flaser_steps_follow_from_the_number_of_readings(
    tmp_path: Path, beams: int, step_deg: float
) -> None:
    line = f"RLASER {beams} {'81.83 ' * beams}0 0 0 0 0 0 1.0 robot 1.0"
    scan = log_of(tmp_path, f"{ODOM}\n{line}").samples[0]
    assert isinstance(scan, Scan)
    assert scan.scanner == "rlaser"
    assert scan.angle_step_rad == math.radians(step_deg)
    assert np.isposinf(scan.ranges_m).all()


def test_a_log_without_odom_takes_the_robot_poses_of_its_scans(tmp_path: Path) -> None:
    odometry, scan = log_of(tmp_path, FLASER).samples
    assert odometry == OdometrySample(stamp_ns=12_500_000_000, odom_from_base=Pose2(1.5, -2.0, 0.5))
    assert scan.stamp_ns == odometry.stamp_ns


def test_gzip_is_told_by_content(tmp_path: Path) -> None:
    plain = log_of(tmp_path, CARMEN)
    packed = gzip.compress(CARMEN.encode())
    for name in ("run.log.gz", "run.clf.gz", "run.log"):
        assert same_log(plain, log_of(tmp_path, packed, name))


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (ODOM.replace("0.5", "nan"), "finite"),
        (ODOM.replace("0.5", "x"), "could not convert"),
        (ODOM.replace("12.000000001", "-1"), "not a time"),
        (ODOM.replace("12.000000001", "1e99"), "not a time"),
        (ODOM.replace("12.000000001", "inf"), "not a time"),
        (ODOM[:-5], "9 fields instead of 10"),
        (FLASER.replace("180", "179", 1), "179 readings"),
        (FLASER.replace("180", "-180", 1), "number of readings"),
        (FLASER.replace("180", "9" * 30, 1), "number of readings"),
        ("FLASER", "number of readings"),
        (ROBOTLASER.replace(" 5 ", " 99999 ", 1), "99999 readings"),
        (ROBOTLASER.replace("0.25", "0", 1), "no scan"),
        (ROBOTLASER.replace(" 30.0 ", " -3 ", 1), "maximum range"),
        (ROBOTLASER[:60], "number of readings"),
        ("ODOX 1 2 3", "unknown message 'ODOX'"),
        ("\x00\x01", "unknown message"),
    ],
)
def test_a_damaged_line_is_named(tmp_path: Path, line: str, reason: str) -> None:
    with pytest.raises(RecordingError) as caught:
        log_of(tmp_path, f"{ODOM}\n{line}\n{ODOM}\n")
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'run.log'}:2: ")
    assert reason in message
    assert "\n" not in message


@fixed
@given(position=st.integers(0, len(CARMEN) - 1), byte=st.integers(0, 255))
def test_one_wrong_byte_gives_an_error_or_as_many_samples(
    tmp_path: Path, position: int, byte: int
) -> None:
    damaged = bytearray(CARMEN.encode())
    damaged[position] = byte
    try:
        log = log_of(tmp_path, bytes(damaged))
    except RecordingError:
        return
    assert len(log.samples) <= 4
    for sample in log.samples:
        assert 0 <= sample.stamp_ns < 10**19
        if isinstance(sample, Scan):
            assert not np.isneginf(sample.ranges_m).any()


@fixed
@given(cut=st.integers(1, len(CARMEN) - 1))
def test_a_cut_log_gives_an_error_or_true_samples(tmp_path: Path, cut: int) -> None:
    whole = log_of(tmp_path, CARMEN)
    try:
        log = log_of(tmp_path, CARMEN[:cut])
    except RecordingError:
        return
    for sample in log.samples:
        if isinstance(sample, OdometrySample):
            assert sample.odom_from_base == Pose2(1.5, -2.0, 0.5)
        else:
            assert any(same(sample, true) for true in whole.samples)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("run.log.gz", gzip.compress(CARMEN.encode())[:-9]),
        ("run.log.gz", b"\x1f\x8b" + b"\xff" * 40),
        ("run.log", b"\xff\xfe\xfd\n"),
        ("run.log", b"# nothing else\n"),
        ("run.log", b"ODOM " + b"1" * 300_000),
        ("run.bag", b"#ROSBAG V2.0\n"),
        ("run.mcap", b""),
        ("run.mcap", b"\x89MCAP0\r\n"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    with pytest.raises(RecordingError, match=name):
        log_of(tmp_path, content, name)


def test_a_missing_log_is_refused(tmp_path: Path) -> None:
    for name in ("none.log", "none.mcap"):
        with pytest.raises(RecordingError, match="No such file"):
            read_log(tmp_path / name)


def test_equal_stamps_put_wheels_before_scans(tmp_path: Path) -> None:
    log = log_of(tmp_path, f"{FLASER}\n{ODOM.replace('12.000000001', '12.5')}\n")
    assert [type(sample) for sample in log.samples] == [OdometrySample, Scan]


numbers = st.floats(-1e6, 1e6)
stamps = st.integers(0, 8_999_999_999_999_999_999)
poses = st.builds(Pose2, numbers, numbers, numbers)
readings = st.one_of(st.floats(0.001, 1e3), st.just(math.inf), st.just(math.nan))
samples = st.one_of(
    st.builds(
        WheelSample,
        stamp_ns=stamps,
        left_rad=numbers,
        right_rad=numbers,
        segment=st.integers(0, 9),
    ),
    st.builds(
        JointSample,
        stamp_ns=stamps,
        names=st.just(("drive", "steer")),
        angles_rad=st.tuples(numbers, numbers),
        segment=st.integers(0, 9),
    ),
    st.builds(OdometrySample, stamp_ns=stamps, odom_from_base=poses, segment=st.integers(0, 9)),
    st.builds(
        Scan,
        scanner=st.sampled_from(["front", "rear"]),
        stamp_ns=stamps,
        ranges_m=st.lists(readings, max_size=9).map(np.array),
        angle_min_rad=numbers,
        angle_step_rad=st.floats(1e-6, 1.0),
        sweep_s=st.floats(0.0, 1.0),
        range_max_m=st.one_of(st.floats(1.0, 100.0), st.just(math.inf)),
        seq=st.none() | st.integers(0, 2**32 - 1),
    ),
)


def write_native(path: Path, log: Log) -> None:
    with RecordingWriter(path) as writer:
        for sample in log.samples:
            writer.write(sample)
        if log.truth is not None:
            for i, stamp_ns in enumerate(log.truth.stamps_ns.tolist()):
                writer.write_truth(stamp_ns, log.truth.pose(i))


@fixed
@given(held=st.lists(samples, max_size=12), truth=st.lists(st.tuples(stamps, poses), max_size=4))
def test_native_recordings_give_back_every_bit(
    tmp_path: Path, held: list[Sample], truth: list[tuple[int, Pose2]]
) -> None:
    truth.sort(key=lambda entry: entry[0])
    trajectory = Trajectory(
        stamps_ns=np.array([stamp for stamp, _ in truth], dtype=np.int64),
        poses=np.array([pose.as_array() for _, pose in truth]).reshape(-1, 3),
    )
    log = Log(samples=tuple(held), truth=trajectory if truth else None)
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_native(first, log)
    write_native(second, log)
    assert first.read_bytes() == second.read_bytes()
    assert same_log(log, read_log(first))


def small_native(path: Path) -> Log:
    log = Log(
        samples=(
            WheelSample(stamp_ns=1, left_rad=0.5, right_rad=0.25),
            Scan(
                scanner="front",
                stamp_ns=2,
                ranges_m=np.array([1.0, math.inf, math.nan, 2.5]),
                angle_min_rad=-1.0,
                angle_step_rad=0.5,
            ),
        ),
        truth=Trajectory(stamps_ns=np.array([1]), poses=np.array([[1.0, 2.0, 0.5]])),
    )
    write_native(path, log)
    return log


def test_any_damaged_byte_of_a_native_recording_is_found_or_harmless(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    log = small_native(path)
    whole = path.read_bytes()
    data_ends = whole.index(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")
    for position in range(0, len(whole), 3):
        damaged = bytearray(whole)
        damaged[position] ^= 0x41
        path.write_bytes(damaged)
        if position < data_ends:
            with pytest.raises(RecordingError, match="damaged"):
                read_log(path)
        else:  # the index after the data is not needed
            with suppress(RecordingError):
                assert same_log(read_log(path), log), position


def test_a_native_recording_cut_anywhere_gives_what_came_before_or_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    log = small_native(path)
    whole = path.read_bytes()
    data_ends = whole.index(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")
    salvaged = 0
    for cut in range(0, len(whole), 3):
        path.write_bytes(whole[:cut])
        caplog.clear()
        with suppress(RecordingError):
            assert same_log(read_log(path), log)
            assert "cut off" in caplog.text
            salvaged += 1
    assert salvaged > (len(whole) - data_ends) // 4  # all cuts after the data, at least


def test_hostile_native_messages_are_refused(tmp_path: Path) -> None:
    for message in (
        b"[]",
        b"{",
        b"[" * 100_000,
        b'{"timestamp":{"sec":-1,"nsec":0}}',
        b'{"timestamp":{"sec":1,"nsec":0},"left_rad":1e999,"right_rad":0,"segment":0}',
        b'{"timestamp":{"sec":1,"nsec":0},"left_rad":NaN,"right_rad":0,"segment":0}',
        b'{"timestamp":{"sec":1,"nsec":0},"left_rad":true,"right_rad":0,"segment":0}',
        b'{"timestamp":{"sec":1,"nsec":0},"left_rad":1,"right_rad":0,"segment":1.5}',
        b'{"timestamp":7,"left_rad":1,"right_rad":0,"segment":0}',
        b"9" * 5000,
        b"\xff",
    ):
        path = tmp_path / "run.mcap"
        with RecordingWriter(path) as writer:
            writer.add(Entry("/wheels", "amr_slam.WheelSample", 1, message))
        with pytest.raises(RecordingError, match="damaged recording"):
            read_log(path)


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.add(Entry("/wheels", "amr_slam.WheelSample", 1, b" " * (100 << 20)))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(RecordingError, match="chunk of"):
        read_log(path)


@fixed
@given(entries=st.lists(st.tuples(stamps, poses), max_size=5))
def test_tum_round_trip(tmp_path: Path, entries: list[tuple[int, Pose2]]) -> None:
    entries.sort(key=lambda entry: entry[0])
    trajectory = Trajectory(
        stamps_ns=np.array([stamp for stamp, _ in entries], dtype=np.int64),
        poses=np.array([pose.as_array() for _, pose in entries]).reshape(-1, 3),
    )
    path = tmp_path / "run.tum"
    write_tum(path, trajectory)
    found = read_tum(path)
    np.testing.assert_array_equal(found.stamps_ns, trajectory.stamps_ns)
    difference = found.poses - trajectory.poses
    assert np.abs(difference[:, :2]).max(initial=0.0) < 1e-6
    assert np.abs(np.sin(0.5 * difference[:, 2])).max(initial=0.0) < 1e-8


@pytest.mark.parametrize(
    "line",
    ["1 2 3", "x 1 2 0 0 0 0 1", "1 1 2 0 0 0 0 0.5", "1 nan 2 0 0 0 0 1", "-1 1 2 0 0 0 0 1"],
)
def test_a_damaged_tum_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "run.tum"
    path.write_text(f"1 1 2 0 0 0 0 1\n{line}\n")
    with pytest.raises(RecordingError, match=r"run\.tum:2: "):
        read_tum(path)


def test_trajectories_check_themselves() -> None:
    with pytest.raises(ValueError, match="decrease"):
        Trajectory(stamps_ns=np.array([2, 1]), poses=np.zeros((2, 3)))
    with pytest.raises(ValueError, match="fit"):
        Trajectory(stamps_ns=np.array([1, 2]), poses=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="finite"):
        Trajectory(stamps_ns=np.array([1]), poses=np.full((1, 3), np.nan))


def test_relations_are_read(tmp_path: Path) -> None:
    path = tmp_path / "run.relations"
    path.write_text("1.5 2.5 0.3 -0.1 0 0 0 0.2\n")
    relations = read_relations(path)
    assert relations.start_ns.tolist() == [1_500_000_000]
    assert relations.end_ns.tolist() == [2_500_000_000]
    assert relations.start_from_end.tolist() == [[0.3, -0.1, 0.2]]
    path.write_text("1.5 2.5 0.3 -0.1 0 0 0\n")
    with pytest.raises(RecordingError, match=r"run\.relations:1: 7 fields"):
        read_relations(path)


@needs_logs
@pytest.mark.parametrize(
    ("name", "scans", "references"),
    [
        ("acapulco", 861, ["corrected"]),
        ("intel", 13631, ["corrected", "corrected_rbpf"]),
        ("mit_csail", 1988, ["corrected", "corrected_rbpf"]),
        ("seattle", 241, ["corrected"]),
    ],
)
def test_real_logs_are_read_and_their_references_fit(
    name: str, scans: int, references: list[str]
) -> None:
    log = read_log(LOGS / f"{name}.log.gz")
    stamps_of_scans = {s.stamp_ns for s in log.samples if isinstance(s, Scan)}
    assert sum(isinstance(s, Scan) for s in log.samples) == scans
    assert sum(isinstance(s, OdometrySample) for s in log.samples) == scans
    for reference in references:
        trajectory = read_tum(LOGS / f"{name}.{reference}.tum")
        assert stamps_of_scans.issuperset(trajectory.stamps_ns.tolist())
