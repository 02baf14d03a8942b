"""The last pose's file, and when it is written: logical clocks, a real disk."""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from daemon_rig import until
from hypothesis import example, given, settings
from hypothesis import strategies as st

from amr_slam.geometry import Pose2
from amr_slam.samples import PoseEstimate, State
from amr_slam.service.last_pose import (
    MOST_AGE_S,
    LastPose,
    UnusableHint,
    clocks_ns,
    decode,
    encode,
    must_be_fresh,
    read,
)
from amr_slam.service.remembering import Recollection, Remembering
from amr_slam.service.worker import ActiveMap

S = 1_000_000_000
HALL = ActiveMap(map_id="838d0393-99c7-5f72-b7b6-44ce3a318038", name="hall", scans=9)


def last_pose(
    *, uptime_ns: int = 500 * S, utc_ns: int = 1000 * S, mapping: bool = False
) -> LastPose:
    return LastPose(
        map_id=HALL.map_id,
        map_name=HALL.name,
        mapping=mapping,
        map_from_base=Pose2(1.5, -2.25, 0.5),
        covariance=np.diag([0.01, 0.0004, 0.0001]),
        uptime_ns=uptime_ns,
        utc_ns=utc_ns,
    )


def estimate(
    x_m: float = 0.0, state: State = State.LOCALIZED, turn_rad: float = 0.0
) -> PoseEstimate:
    return PoseEstimate(
        stamp_ns=1,
        map_from_base=Pose2(x_m, 0.0, turn_rad),
        covariance=np.diag([1e-4, 1e-4, 1e-4]),
        odom_from_base=Pose2.identity(),
        vx_mps=0.0,
        omega_radps=0.0,
        state=state,
        epoch=0,
        error95_m=0.02,
        since_fix_s=0.1,
        since_fix_m=0.1,
    )


def test_what_is_written_is_read_again() -> None:
    last = last_pose(mapping=True)
    again = decode(encode(last))
    assert again.map_from_base == last.map_from_base
    np.testing.assert_array_equal(again.covariance, last.covariance)
    assert (again.map_id, again.map_name, again.mapping) == (HALL.map_id, "hall", True)
    assert again.spread_m == pytest.approx(0.3)


@settings(derandomize=True, deadline=None)
@given(st.integers(0, 400), st.integers(1, 255))
def test_no_damage_goes_unseen(at: int, flipped: int) -> None:
    data = bytearray(encode(last_pose()))
    data[at % (len(data) - 1)] ^= flipped  # the last line end does not matter
    with pytest.raises(UnusableHint):
        decode(bytes(data))
    with pytest.raises(UnusableHint):
        decode(bytes(data[: at % (len(data) - 1)]))


@settings(derandomize=True, deadline=None)
@given(st.binary(max_size=5000))
@example(b"")
@example(b"null\n" + b"x" * 64)
def test_nonsense_is_refused(data: bytes) -> None:
    with pytest.raises(UnusableHint):
        decode(data)


def forged(**changed: object) -> bytes:
    """A file whose checksum is right and whose content was changed."""
    fields = json.loads(encode(last_pose()).partition(b"\n")[0])
    line = json.dumps(fields | changed).encode() + b"\n"
    return line + hashlib.sha256(line).hexdigest().encode() + b"\n"


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"v": 2}, "version 2 of the file is unknown"),
        ({"x": math.nan}, "nan is no possible number"),
        ({"y": -1.1e5}, "no possible number"),
        ({"theta": True}, "True is no number"),
        ({"theta": "0.5"}, "is no number"),
        ({"map": 7}, "the map has no name"),
        ({"name": None}, "the map has no name"),
        ({"covariance": [1.0] * 8}, "makes no sense"),
        ({"covariance": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]}, "the covariance is none"),
        ({"covariance": [1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]}, "the covariance is none"),
        ({"name": "x" * 4000}, "damaged"),
    ],
)
def test_a_whole_file_that_makes_no_sense_is_no_hint(
    changed: dict[str, object], reason: str
) -> None:
    assert decode(forged(x=1e5)).map_from_base.x_m == 1e5
    with pytest.raises(UnusableHint, match=reason):
        decode(forged(**changed))


def test_a_file_that_is_none_says_why(tmp_path: Path) -> None:
    with pytest.raises(UnusableHint, match=r"^there is none$"):
        read(tmp_path / "missing")
    with pytest.raises(UnusableHint, match="cannot be read: Is a directory"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("uptime_s", "utc_s", "reason"),
    [
        (500.0, 1000.0, None),
        (500.0 + MOST_AGE_S, 1000.0 + MOST_AGE_S, None),
        (501.0 + MOST_AGE_S, 1001.0 + MOST_AGE_S, "old"),
        (20.0, 1060.0, "started anew"),
        (499.0, 999.0, "started anew"),
        (520.0, 1025.0, None),
        (520.0, 1060.0, "its clock was set"),
        (520.0, 4620.0, "its clock was set"),
    ],
)
def test_an_old_pose_and_one_of_another_start_are_no_hint(
    uptime_s: float, utc_s: float, reason: str | None
) -> None:
    now = round(S * uptime_s), round(S * utc_s)
    if reason is None:
        must_be_fresh(last_pose(), *now)
    else:
        with pytest.raises(UnusableHint, match=reason):
            must_be_fresh(last_pose(), *now)


def test_a_robot_that_drives_all_day_writes_a_bounded_number_of_times(tmp_path: Path) -> None:
    remembering = Remembering(tmp_path / "amr7.lastpose")
    written: list[float] = []
    remembering._want = lambda wanted: written.append(wanted.map_from_base.x_m)  # type: ignore[method-assign, union-attr]
    hour_s, rate_hz = 3600, 10
    for tick in range(hour_s * rate_hz):
        remembering.note(
            tick * S // rate_hz, estimate(x_m=2.0 * tick / rate_hz), HALL, mapping=False
        )
    assert len(written) == pytest.approx(hour_s / 2.0, abs=2)
    # What it may have driven since is well within the search's radius of 5 m.
    assert max(np.diff(written)) < 4.3
    standing = len(written)
    for tick in range(hour_s * rate_hz):
        remembering.note((hour_s + 1) * S + tick * S // rate_hz, estimate(), HALL, mapping=False)
    assert len(written) - standing == pytest.approx(hour_s / 30.0, abs=2)
    remembering.close()


def test_turning_on_the_spot_is_a_way_too(tmp_path: Path) -> None:
    remembering = Remembering(tmp_path / "amr7.lastpose")
    remembering.note(0, estimate(), HALL, mapping=False)
    remembering.note(3 * S, estimate(turn_rad=0.2), HALL, mapping=False)
    first = remembering._written
    remembering.note(6 * S, estimate(turn_rad=-0.35), HALL, mapping=False)
    assert remembering._written is not first
    remembering.close()


def test_what_is_not_known_is_forgotten_but_for_a_map_that_grows(tmp_path: Path) -> None:
    path = tmp_path / "amr7.lastpose"
    remembering = Remembering(path)
    remembering.note(0, estimate(), HALL, mapping=False)
    until(path.exists, "the file")
    remembering.note(1, estimate(state=State.ODOMETRY_ONLY, x_m=9.0), HALL, mapping=False)
    assert read(path).map_from_base.x_m == 0.0
    remembering.note(2, estimate(state=State.LOST), HALL, mapping=False)
    until(lambda: not path.exists(), "its end")
    remembering.note(3 * S, estimate(state=State.MAPPING), HALL, mapping=True)
    until(path.exists, "the file")
    remembering.note(4 * S, estimate(state=State.LOST), HALL, mapping=True)
    assert read(path).mapping
    assert Recollection(path).cut_off == "hall"
    remembering.close()
    remembering.close()
    assert not path.exists()


def test_a_map_that_was_growing_is_gone_on_with_after_any_time(tmp_path: Path) -> None:
    path = tmp_path / "amr7.lastpose"
    path.write_bytes(encode(last_pose(mapping=True)))
    recollection = Recollection(path)
    assert recollection.cut_off == "hall"
    assert recollection.hint is None
    uptime_ns, utc_ns = clocks_ns()
    path.write_bytes(encode(last_pose(uptime_ns=uptime_ns, utc_ns=utc_ns)))
    recollection = Recollection(path)
    assert recollection.cut_off is None
    assert recollection.hint is not None


def test_a_disk_that_refuses_is_told_until_it_takes_it_again(tmp_path: Path) -> None:
    folder = tmp_path / "maps"
    folder.write_text("in the way")
    remembering = Remembering(folder / "amr7.lastpose")
    remembering.note(0, estimate(), HALL, mapping=False)
    until(lambda: remembering.trouble is not None, "the trouble")
    assert "the last pose is not kept: " in (remembering.trouble or "")
    os.unlink(folder)
    remembering.note(60 * S, estimate(), HALL, mapping=False)
    until(lambda: remembering.trouble is None, "its end")
    assert (folder / "amr7.lastpose").exists()
    remembering.close()


def test_poses_that_are_worth_little_are_not_kept(tmp_path: Path) -> None:
    remembering = Remembering(tmp_path / "amr7.lastpose")
    for state in (State.STARTING, State.ODOMETRY_ONLY):
        remembering.note(0, estimate(state=state), HALL, mapping=False)
    remembering.note(0, estimate(), None, mapping=False)
    assert remembering._written is None
    remembering.close()
    assert math.isfinite(last_pose().spread_m)
