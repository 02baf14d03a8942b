"""What camera systems say, well or badly formed."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.shadow import CameraPose, CameraPoseError, ShadowSettings, parse

PLAIN = ShadowSettings(key="cameras/pose")
RECEIVED_S = 1_790_000_000.0
GOOD = {"x": 1.0, "y": 2.0, "theta": 0.5, "stamp": 1_790_000_000.25}


def parsed(message: Any, how: ShadowSettings = PLAIN, robot: str = "amr7") -> CameraPose | None:
    payload = message if isinstance(message, bytes) else json.dumps(message).encode()
    return parse(payload, how, robot, RECEIVED_S)


def test_a_plain_message() -> None:
    assert parsed(GOOD) == CameraPose(stamp_s=1_790_000_000.25, x_m=1.0, y_m=2.0, theta_rad=0.5)


def test_nested_fields_units_and_a_list_of_robots() -> None:
    how = ShadowSettings(
        key="cameras/**", entries="objects", x="pose.position.0", y="pose.position.1",
        theta="pose.yaw", stamp="time", robot="id", robot_id="17", length_unit="mm",
        angle_unit="deg", time_unit="iso",
    )  # fmt: skip
    mine = {"id": 17, "pose": {"position": [1500.0, -2500], "yaw": 270.0}}
    message = {
        "time": "2026-11-24T18:00:00.5Z",
        "objects": [{"id": "16", "pose": {"position": [0, 0], "yaw": 0}}, mine],
    }
    pose = parsed(message, how)
    assert pose is not None
    assert (pose.x_m, pose.y_m, pose.stamp_s) == (1.5, -2.5, 1795543200.5)
    assert pose.theta_rad == pytest.approx(-math.pi / 2.0)
    assert parsed({"time": "2026-11-24T18:00:00Z", "objects": [{"id": "16"}]}, how) is None


def test_without_heading_and_stamp() -> None:
    how = ShadowSettings(key="cameras/pose", theta="", stamp="")
    assert parsed({"x": 1, "y": 2}, how) == CameraPose(
        stamp_s=RECEIVED_S, x_m=1.0, y_m=2.0, theta_rad=None
    )


def test_another_robot_is_not_ours() -> None:
    how = ShadowSettings(key="cameras/pose", robot="robot")
    assert parsed({**GOOD, "robot": "amr8"}, how) is None
    assert parsed({**GOOD, "robot": "amr7"}, how) is not None


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"\xff\xfe",
        b"[" * 5000,
        b'{"x": NaN, "y": 2, "theta": 0, "stamp": 1}',
        b'{"x": Infinity, "y": 2, "theta": 0, "stamp": 1}',
        b'{"x": 1e999, "y": 2, "theta": 0, "stamp": 1}',
        b'{"x": 1' + 400 * b"0" + b', "y": 2, "theta": 0, "stamp": 1}',
        b'{"x": 1' + 5000 * b"0" + b', "y": 2, "theta": 0, "stamp": 1}',
        b"{" + 70_000 * b" " + b"}",
        [],
        3,
        {},
        {**GOOD, "x": "1"},
        {**GOOD, "x": True},
        {**GOOD, "x": None},
        {**GOOD, "x": 2e6},
        {**GOOD, "stamp": -1.0},
        {**GOOD, "stamp": 1_790_000_000_250},
        {**GOOD, "stamp": "2026-11-24T18:00:00Z"},
        {"x": 1.0, "y": 2.0, "theta": 0.5},
    ],
)
def test_what_is_no_pose_is_refused(message: Any) -> None:
    with pytest.raises(CameraPoseError):
        parsed(message)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["x", "y", "theta", "stamp", "id"]), inner, max_size=5)
    ),
    max_leaves=12,
)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(message=JSON)
def test_whatever_comes_is_a_finite_pose_or_refused(message: Any) -> None:
    for how in (PLAIN, ShadowSettings(key="k", entries="x", robot="id", time_unit="iso")):
        try:
            pose = parsed(message, how)
        except CameraPoseError:
            continue
        if pose is not None:
            assert math.isfinite(pose.x_m + pose.y_m + (pose.theta_rad or 0.0) + pose.stamp_s)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(payload=st.binary(max_size=200))
def test_any_bytes(payload: bytes) -> None:
    try:
        parse(payload, PLAIN, "amr7", RECEIVED_S)
    except CameraPoseError:
        return


@pytest.mark.parametrize(
    "wrong", [{"key": "a b"}, {"key": "/a"}, {"key": "a?b"}, {"x": ""}, {"theta": "a..b"}]
)
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, str]) -> None:
    with pytest.raises(ValueError, match=r"should be|must be named"):
        ShadowSettings(**({"key": "cameras/pose"} | wrong))  # type: ignore[arg-type]
