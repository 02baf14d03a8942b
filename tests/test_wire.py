from __future__ import annotations

import json
import math
import uuid
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import status_of
from pydantic import ValidationError

from amr_slam.fusion import Calibration, Slip
from amr_slam.geometry import Array, Pose2
from amr_slam.reporting import (
    calibration_part,
    candidate_part,
    health_part,
    map_from_base,
    pose_message,
    scan_message,
    slip_part,
)
from amr_slam.samples import Candidate, Health, Link, PoseEstimate, State
from amr_slam.wheel_events import WheelEvent
from amr_slam.wire import (
    COMMANDS,
    MAX_MESSAGE_BYTES,
    MAX_SCAN_POINTS,
    UNKNOWN,
    HealthPart,
    MapImage,
    MapPart,
    OdomPose,
    PoseMessage,
    ScanMessage,
    StatusMessage,
    WireError,
    json_schemas,
    robot_key,
    robot_of,
)

POSE_FIELDS = {
    "v", "robot", "seq", "stamp", "age_s", "map", "epoch", "x", "y", "theta", "vx", "omega",
    "covariance", "error95_m", "state", "since_fix_s", "since_fix_m", "odom", "fault",
}  # fmt: skip
"""As contracted."""
ADDED = {"epoch_delta", "every"}
"""Since then: absent in messages of earlier versions."""
MAP_ID = str(uuid.UUID(int=7))
derandomized = settings(derandomize=True, deadline=None, max_examples=100)

finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(0, 1e300)
angles = st.floats(-math.pi, math.pi, exclude_min=True)
counts = st.integers(0, 2**63)
names = st.text(min_size=1, max_size=64)
texts = st.text(max_size=500)
poses = st.builds(
    PoseMessage,
    robot=names,
    seq=counts,
    stamp=positive,
    age_s=positive,
    map=st.none() | st.uuids().map(str),
    epoch=counts,
    x=finite,
    y=finite,
    theta=angles,
    vx=finite,
    omega=finite,
    covariance=st.tuples(*[finite] * 9),
    error95_m=positive,
    state=st.sampled_from(State),
    since_fix_s=positive,
    since_fix_m=positive,
    odom=st.builds(OdomPose, x=finite, y=finite, theta=angles),
    fault=st.none() | texts,
)
parts = st.builds(
    HealthPart,
    link=st.sampled_from(["OK", "STALE", "LOST"]),
    age_s=st.none() | positive,
    rate_hz=positive,
    samples=counts,
    errors=counts,
    detail=st.none() | texts,
)
statuses = st.builds(
    StatusMessage,
    robot=names,
    seq=counts,
    stamp=positive,
    state=st.sampled_from(State),
    mode=st.sampled_from(["mapping", "localization"]),
    map=st.none() | st.builds(MapPart, id=st.uuids().map(str), name=names, version=counts),
    scanners=st.dictionaries(names, parts, max_size=3),
    wheels=parts,
    slam=parts,
    outcomes=st.dictionaries(names, counts, max_size=4),
    clock_steps=counts,
    version=names,
    uptime_s=positive,
    cpu_percent=positive,
    memory_mb=positive,
    fault=st.none() | texts,
)


def estimate(**changes: Any) -> PoseEstimate:
    values: dict[str, Any] = {
        "stamp_ns": 5_000_000_000,
        "map_from_base": Pose2(1.0, 2.0, 3.0),
        "covariance": np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]),
        "odom_from_base": Pose2(0.5, 0.25, -0.125),
        "vx_mps": 0.3,
        "omega_radps": -0.1,
        "state": State.LOCALIZED,
        "epoch": 2,
        "error95_m": 0.04,
        "since_fix_s": 1.5,
        "since_fix_m": 0.45,
        "wheel_age_s": 0.01,
    }
    return PoseEstimate(**(values | changes))


def message(**changes: Any) -> PoseMessage:
    return pose_message(
        estimate(**changes),
        robot="amr7",
        seq=41,
        utc_from_monotonic_ns=1_700_000_000_000_000_000,
        map_id=MAP_ID,
    )


def changed(**changes: object) -> bytes:
    return json.dumps(json.loads(message().encode()) | changes).encode()


def test_a_pose_has_the_contracts_fields_and_the_estimates_values() -> None:
    assert json.loads(
        message(fault="front LOST", epoch_delta=Pose2(0.5, -0.25, 0.125)).encode()
    ) == {
        "v": 1,
        "robot": "amr7",
        "seq": 41,
        "stamp": 1_700_000_005.0,
        "age_s": 0.01,
        "map": MAP_ID,
        "epoch": 2,
        "x": 1.0,
        "y": 2.0,
        "theta": 3.0,
        "vx": 0.3,
        "omega": -0.1,
        "covariance": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
        "error95_m": 0.04,
        "state": "localized",
        "since_fix_s": 1.5,
        "since_fix_m": 0.45,
        "odom": {"x": 0.5, "y": 0.25, "theta": -0.125},
        "fault": "front LOST",
        "epoch_delta": {"x": 0.5, "y": -0.25, "theta": 0.125},
        "every": 1,
    }
    assert message().epoch_delta is None
    assert set(PoseMessage.model_fields) == POSE_FIELDS | ADDED
    assert map_from_base(message()) == Pose2(1.0, 2.0, 3.0)


def test_what_is_not_known_yet_is_a_large_number_not_infinity() -> None:
    sent = message(error95_m=math.inf, since_fix_s=math.inf, since_fix_m=math.inf)
    assert (sent.error95_m, sent.since_fix_s, sent.since_fix_m) == (UNKNOWN,) * 3


def test_a_status_has_the_contracts_content() -> None:
    ok = health_part(Health(link=Link.OK, age_s=0.1, rate_hz=0.5, samples=9, errors=1))
    lost = health_part(Health(link=Link.LOST, detail="no such port"))
    status = StatusMessage(
        robot="amr7",
        seq=0,
        stamp=1.0,
        state=State.MAPPING,
        mode="mapping",
        map=MapPart(id=MAP_ID, name="hall", version=3),
        scanners={"front": ok, "rear": lost},
        wheels=ok,
        slam=ok,
        version="0.1.0",
        uptime_s=2.0,
        cpu_percent=3.0,
        memory_mb=4.0,
    )
    sent = json.loads(status.encode())
    assert sent["scanners"]["front"] == {
        "link": "OK", "age_s": 0.1, "rate_hz": 0.5, "samples": 9, "errors": 1, "detail": None,
    }  # fmt: skip
    assert sent["scanners"]["rear"]["link"] == "LOST"
    assert sent["scanners"]["rear"]["age_s"] is None
    assert sent["map"] == {"id": MAP_ID, "name": "hall", "version": 3}
    assert (sent["v"], sent["state"], sent["mode"]) == (1, "mapping", "mapping")
    assert list(status.health()) == ["front", "rear", "wheels", "slam"]
    assert {link.name for link in Link} == {"OK", "STALE", "LOST"}


@derandomized
@given(sent=poses)
def test_poses_come_back_as_they_were(sent: PoseMessage) -> None:
    assert PoseMessage.decode(sent.encode()) == sent
    assert set(json.loads(sent.encode())) == POSE_FIELDS | ADDED


@derandomized
@given(sent=statuses)
def test_statuses_come_back_as_they_were(sent: StatusMessage) -> None:
    assert StatusMessage.decode(sent.encode()) == sent


@derandomized
@given(theta=st.floats(-1e6, 1e6), odom=st.floats(-1e6, 1e6))
def test_angles_leave_in_their_interval(theta: float, odom: float) -> None:
    sent = message(map_from_base=Pose2(0, 0, theta), odom_from_base=Pose2(0, 0, odom))
    for angle in (sent.theta, sent.odom.theta):
        assert -math.pi < angle <= math.pi


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nothing_leaves_that_is_not_finite(bad: float) -> None:
    covariance = np.eye(3)
    covariance[2, 1] = bad
    for changes in (
        {"map_from_base": Pose2(bad, 0.0, 0.0)},
        {"odom_from_base": Pose2(0.0, bad, 0.0)},
        {"covariance": covariance},
        {"vx_mps": bad},
        {"omega_radps": bad},
        {"wheel_age_s": bad},
    ):
        with pytest.raises(ValueError, match="finite"):
            message(**changes)
    with pytest.raises(ValueError, match="finite"):
        message(error95_m=math.nan)


@pytest.mark.parametrize(
    ("payload", "complaint"),
    [
        (b"", "pose: payload: "),
        (b"\xff\xfe", "pose: payload: "),
        (b"[1]", "pose: payload: "),
        (b"[" * 10_000, "pose: payload: "),
        (b"{}", "pose: robot: "),
        (b" " * (MAX_MESSAGE_BYTES + 1), f"pose: {MAX_MESSAGE_BYTES + 1} bytes, at most 65536"),
        (changed(v=2), "pose: v: "),
        (changed(x=math.nan), "pose: x: "),
        (changed(y=math.inf), "pose: y: "),
        (changed(x="1.0"), "pose: x: "),
        (changed(theta=-math.pi), "pose: theta: "),
        (changed(theta=3.2), "pose: theta: "),
        (changed(covariance=[0.0] * 8), "pose: covariance"),
        (changed(covariance=[0.0] * 10), "pose: covariance"),
        (changed(covariance=[0.0] * 8 + [None]), "pose: covariance.8: "),
        (changed(error95_m=-0.1), "pose: error95_m: "),
        (changed(error95_m=None), "pose: error95_m: "),
        (changed(state="fine"), "pose: state: "),
        (changed(seq=-1), "pose: seq: "),
        (changed(seq=True), "pose: seq: "),
        (changed(map="hall"), "pose: map: "),
        (changed(robot=""), "pose: robot: "),
        (changed(odom={"x": 0.0, "y": 0.0}), "pose: odom.theta: "),
        (changed(fault="a" * 501), "pose: fault: "),
    ],
)
def test_what_is_no_pose_is_refused_in_one_line(payload: bytes, complaint: str) -> None:
    with pytest.raises(WireError) as caught:
        PoseMessage.decode(payload)
    assert str(caught.value).startswith(complaint)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", sorted(POSE_FIELDS))
def test_every_field_is_required(missing: str) -> None:
    fields = json.loads(message().encode())
    del fields[missing]
    with pytest.raises(WireError, match=rf"^pose: {missing}: "):
        PoseMessage.decode(json.dumps(fields).encode())


def test_further_fields_are_a_newer_senders() -> None:
    assert PoseMessage.decode(changed(tilt=0.1)) == message()


@derandomized
@given(payload=st.binary(max_size=300))
def test_junk_is_refused(payload: bytes) -> None:
    for kind in (PoseMessage, StatusMessage):
        with pytest.raises(WireError):
            kind.decode(payload)


@derandomized
@given(start=st.integers(0, 600), length=st.integers(0, 20), middle=st.binary(max_size=8))
def test_damage_is_refused_or_harmless(start: int, length: int, middle: bytes) -> None:
    whole = message().encode()
    try:
        received = PoseMessage.decode(whole[:start] + middle + whole[start + length :])
    except WireError:
        return
    assert np.isfinite(received.covariance).all()
    assert -math.pi < received.theta <= math.pi


def test_messages_do_not_change() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        message().x = 2.0


def test_a_status_tells_where_an_ambiguous_robot_may_be() -> None:
    places = [
        candidate_part(Candidate(map_from_base=Pose2(x, 2.0, -0.5), odds=odds))
        for x, odds in ((1.0, 0.6), (9.0, 0.3))
    ]
    said = status_of(candidates=tuple(places), explained=0.8)
    heard = StatusMessage.decode(said.encode())
    assert heard == said
    assert [(one.x, one.theta, one.odds) for one in heard.candidates] == [
        (1.0, -0.5, 0.6),
        (9.0, -0.5, 0.3),
    ]
    older = json.loads(said.encode())
    del older["candidates"], older["explained"]
    assert StatusMessage.decode(json.dumps(older).encode()).candidates == ()
    with pytest.raises(WireError, match="candidates"):
        StatusMessage.decode(json.dumps(older | {"candidates": [{"x": 0.0}]}).encode())
    with pytest.raises(ValidationError):
        status_of(candidates=tuple(3 * places))
    with pytest.raises(ValidationError):
        status_of(explained=1.2)


def test_schemas_are_json_and_name_every_field() -> None:
    schemas = json.loads(json.dumps(json_schemas()))
    said = {"pose", "status", "scan", "map_image", "map_changes", "reply"}
    assert set(schemas) == said | set(COMMANDS)
    assert set(schemas["pose"]["properties"]) == POSE_FIELDS | ADDED
    assert POSE_FIELDS - {"v"} <= set(schemas["pose"]["required"])
    covariance = schemas["pose"]["properties"]["covariance"]
    assert (covariance["minItems"], covariance["maxItems"]) == (9, 9)
    assert schemas["pose"]["$defs"]["State"]["enum"] == [state.value for state in State]


def test_a_robots_name_is_found_in_its_keys() -> None:
    assert robot_key("works/amr", "amr7", "pose") == "works/amr/amr7/pose"
    assert robot_of("works/amr/amr7/pose") == "amr7"


@derandomized
@given(count=st.integers(0, 50), most=st.integers(1, 60))
def test_a_thinned_scan_keeps_the_order_and_the_bound(count: int, most: int) -> None:
    whole = scan(np.column_stack((np.arange(float(count)), np.zeros(count))))
    thin = whole.thinned(most)
    assert len(thin.points) <= most
    assert len(thin.points) >= min(count, (most + 1) // 2)
    assert list(thin.points) == sorted(thin.points)
    assert set(thin.points) <= set(whole.points)
    assert thin.points[:1] == whole.points[:1]


def scan(points: Array, map_id: str | None = MAP_ID) -> ScanMessage:
    return scan_message(
        points,
        robot="amr7",
        seq=3,
        stamp_ns=5_000_000_000,
        utc_from_monotonic_ns=1_700_000_000_000_000_000,
        map_id=map_id,
        epoch=1,
    )


def test_a_scan_is_rounded_thinned_out_and_fits_into_a_message() -> None:
    sent = scan(np.array([[1.00049, -2.0], [0.0, 3.14159]]))
    assert json.loads(sent.encode()) == {
        "v": 1,
        "robot": "amr7",
        "seq": 3,
        "stamp": 1_700_000_005.0,
        "map": MAP_ID,
        "epoch": 1,
        "points": [[1.0, -2.0], [0.0, 3.142]],
    }
    assert ScanMessage.decode(sent.encode()) == sent
    assert scan(np.empty((0, 2)), None).points == ()
    many = scan(np.column_stack([np.arange(2 * MAX_SCAN_POINTS + 1), np.full(4001, -99_999.123)]))
    assert len(many.points) == 1334
    assert many.points[1] == (3.0, -99_999.123)
    widest = scan(np.full((MAX_SCAN_POINTS, 2), -99_999.123))
    assert len(widest.encode()) <= MAX_MESSAGE_BYTES
    with pytest.raises(ValueError, match="finite"):
        scan(np.array([[math.inf, 0.0]]))


def test_the_picture_of_a_map_says_where_it_lies() -> None:
    said = MapImage(
        map=MAP_ID,
        width_px=800,
        height_px=600,
        metres_per_px=0.05,
        column_of_x0_px=400.0,
        row_of_y0_px=300.5,
    )
    assert MapImage.decode(said.encode()) == said
    for bad in ({"width_px": 0}, {"height_px": 10**6}, {"metres_per_px": 0.0}):
        with pytest.raises(WireError, match=f"^map_image: {next(iter(bad))}: "):
            MapImage.decode(json.dumps(json.loads(said.encode()) | bad).encode())


def test_what_is_known_of_the_wheels_is_told_as_scales_with_their_sigmas() -> None:
    known = Calibration(travel=0.02, yaw=-0.05, bend_radpm=0.01, lag_s=0.1, travel_sigma=0.001)
    part = calibration_part(known)
    assert part.travel_scale == pytest.approx(1.02)
    assert part.yaw_scale == pytest.approx(0.95)
    assert (part.bend_radpm, part.lag_s, part.travel_scale_sigma) == (0.01, 0.1, 0.001)
    slip = Slip(
        stamp_ns=5_000_000_000, since_ns=3_000_000_000, forward_m=-0.3, left_m=0.0, turn_rad=0.2
    )
    event = slip_part(WheelEvent(slip=slip, text="left wheel slips"), 1_000_000_000)
    assert (event.stamp, event.forward_m, event.text) == (6.0, -0.3, "left wheel slips")
