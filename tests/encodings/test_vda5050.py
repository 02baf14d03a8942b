"""VDA 5050 from pose messages: the standard's fields, and never more trust than there is."""

from __future__ import annotations

import json
import math
import re
import tomllib
from datetime import datetime
from typing import Any

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import MAP_ID, pose_of, status_of
from paths import REPO
from robot_file import ROBOT

from amr_slam.config import ConfigError, parse
from amr_slam.encodings import Encoder
from amr_slam.encodings.vda5050 import Vda5050Settings, Version, encoders
from amr_slam.encodings.vda5050.fields import timestamp
from amr_slam.samples import State
from amr_slam.wire import UNKNOWN, MapPart, PoseMessage, WireError

derandomized = settings(derandomize=True, deadline=None, max_examples=100)
VERSIONS: list[Version] = ["2.1", "3.0"]
MAJOR = {"2.1": "v2", "3.0": "v3"}
POSITION = {"2.1": "agvPosition", "3.0": "mobileRobotPosition"}
LOCALIZED = {"2.1": "positionInitialized", "3.0": "localized"}
BOTH = pytest.mark.parametrize("version", VERSIONS)
SCHEMAS = {
    version: json.loads((REPO / f"docs/schemas/vda5050/{version}.json").read_text())
    for version in VERSIONS
}


def encoder(version: Version = "2.1", pose_hz: float = 10.0, **changes: Any) -> Encoder:
    chosen = Vda5050Settings(versions=(version,), manufacturer="acme", **changes)
    (made,) = encoders(chosen, prefix="amr", robot="amr7", pose_hz=pose_hz)
    return made


def said(made: Encoder, message: PoseMessage) -> dict[str, Any]:
    """By the last part of the key."""
    return {
        encoded.key.rpartition("/")[2]: json.loads(encoded.payload)
        for encoded in made.pose(message)
    }


def validate(version: Version, kind: str, message: Any) -> None:
    schema = {**SCHEMAS[version], "$ref": f"#/$defs/{kind}"}
    jsonschema.Draft202012Validator(schema).validate(message)


@BOTH
def test_the_schemas_are_schemas_and_refuse_misspelt_and_missing_fields(version: Version) -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMAS[version])
    right = said(encoder(version), pose_of())["visualization"]
    validate(version, "visualization", right)
    position = right[POSITION[version]]
    for wrong in (
        {key: value for key, value in position.items() if key != LOCALIZED[version]},
        {**position, "mapID": "x"},
        {**position, "theta": 3.2},
        {**position, "localizationScore": 1.1},
        {**position, "deviationRange": -0.1},
    ):
        with pytest.raises(jsonschema.ValidationError):
            validate(version, "visualization", {**right, POSITION[version]: wrong})


def test_2_1_word_for_word() -> None:
    made = encoder("2.1")
    made.status(status_of())
    message = pose_of(seq=12, stamp=1_790_000_000.125, error95_m=0.05)
    assert said(made, message) == {
        "visualization": {
            "headerId": 0,
            "timestamp": "2026-09-21T14:13:20.125Z",
            "version": "2.1.0",
            "manufacturer": "acme",
            "serialNumber": "amr7",
            "agvPosition": {
                "x": 1.5,
                "y": -2.25,
                "theta": 0.5,
                "mapId": MAP_ID,
                "mapDescription": "hall",
                "positionInitialized": True,
                "localizationScore": 0.9,
                "deviationRange": 0.05,
            },
            "velocity": {"vx": 0.3, "omega": -0.1},
        },
        "state_part": {
            "v": 1,
            "seq": 12,
            "epoch": 2,
            "stamp": 1_790_000_000.125,
            "state": {
                "agvPosition": {
                    "x": 1.5,
                    "y": -2.25,
                    "theta": 0.5,
                    "mapId": MAP_ID,
                    "mapDescription": "hall",
                    "positionInitialized": True,
                    "localizationScore": 0.9,
                    "deviationRange": 0.05,
                },
                "velocity": {"vx": 0.3, "omega": -0.1},
                "maps": [
                    {
                        "mapId": MAP_ID,
                        "mapVersion": MAP_ID,
                        "mapStatus": "ENABLED",
                        "mapDescription": "hall",
                    }
                ],
                "errors": [],
            },
        },
    }


def test_3_0_lost_word_for_word() -> None:
    made = encoder("3.0")
    made.status(status_of())
    message = pose_of(
        seq=12, stamp=1_790_000_000.9996, state=State.LOST, error95_m=UNKNOWN, fault="rear: standby"
    )
    told = said(made, message)
    assert told["visualization"] == {
        "headerId": 0,
        "timestamp": "2026-09-21T14:13:21.000Z",
        "version": "3.0.0",
        "manufacturer": "acme",
        "serialNumber": "amr7",
        "referenceStateHeaderId": 0,
        "mobileRobotPosition": {
            "x": 1.5,
            "y": -2.25,
            "theta": 0.5,
            "mapId": MAP_ID,
            "localized": False,
            "localizationScore": 0.0,
        },
        "velocity": {"vx": 0.3, "omega": -0.1},
    }
    assert told["state_part"]["state"]["errors"] == [
        {
            "errorType": "LOCALIZATION_ERROR",
            "errorLevel": "FATAL",
            "errorDescription": "lost: no place in the map fits the scans; rear: standby",
            "errorHint": "Look where the vehicle stands; set its position (initializePosition).",
        }
    ]
    assert told["state_part"]["state"]["maps"][0]["mapDescriptor"] == "hall"


angles = st.floats(-math.pi, math.pi, exclude_min=True)
anything = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def estimates(draw: st.DrawFn) -> PoseMessage:
    return pose_of(
        seq=draw(st.integers(0, 1 << 40)),
        stamp=draw(st.floats(0.0, 4e9)),
        epoch=draw(st.integers(0, 1 << 40)),
        map=draw(st.sampled_from([MAP_ID, None])),
        x=draw(anything),
        y=draw(anything),
        theta=draw(angles),
        vx=draw(anything),
        omega=draw(anything),
        covariance=(0.01, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, draw(st.floats(-0.01, 0.1))),
        error95_m=draw(st.floats(0.0, 2.0) | st.floats(0.0, UNKNOWN)),
        state=draw(st.sampled_from(State)),
        fault=draw(st.none() | st.text(max_size=500)),
    )


@BOTH
@derandomized
@given(message=estimates(), limit_m=st.floats(0.01, 100.0), with_map=st.booleans())
def test_of_any_estimate_comes_a_valid_message_and_no_trust_that_is_not_there(
    version: Version, message: PoseMessage, limit_m: float, with_map: bool
) -> None:
    made = encoder(version, trusted_error_m=limit_m)
    made.status(status_of(map=MapPart(id=MAP_ID, name="hall", version=1) if with_map else None))
    told = said(made, message)
    for kind, content in told.items():
        validate(version, kind, content)
        json.dumps(content, allow_nan=False)
    visible, state = told["visualization"], told["state_part"]["state"]
    position = visible[POSITION[version]]
    assert state[POSITION[version]] == position
    assert state["velocity"] == visible["velocity"] == {"vx": message.vx, "omega": message.omega}
    assert (position["x"], position["y"]) == (message.x, message.y)
    assert -math.pi <= position["theta"] == message.theta <= math.pi
    localized = position[LOCALIZED[version]]
    if message.state in {State.LOST, State.AMBIGUOUS, State.STARTING} or message.map is None:
        assert not localized
    if message.error95_m > limit_m or not 0.0 <= message.covariance[8] <= math.radians(10.0) ** 2:
        assert not localized
    assert position.get("deviationRange", UNKNOWN) == message.error95_m
    assert 0.0 <= position["localizationScore"] <= 1.0
    assert localized or position["localizationScore"] == 0.0
    assert localized is (state["errors"] == [])
    assert state["maps"] == [] or state["maps"][0]["mapId"] == position["mapId"] != ""
    assert (message.map is None) is (state["maps"] == [])


@pytest.mark.parametrize(
    ("state", "error95_m", "localized", "reason"),
    [
        (State.LOCALIZED, 0.5, True, None),
        (State.MAPPING, 0.1, True, None),
        (State.ODOMETRY_ONLY, 0.4, True, None),
        (State.ODOMETRY_ONLY, 0.61, False, "odometry_only: the position error is up to 0.61 m, "),
        (State.LOCALIZED, 0.51, False, "localized: the position error is up to 0.51 m, more than "),
        (State.LOCALIZED, UNKNOWN, False, "localized: the position error is not known"),
        (State.AMBIGUOUS, 0.01, False, "ambiguous: a place is not confirmed, or several"),
        (State.STARTING, 0.01, False, "starting: no scan has been registered yet"),
    ],
)
def test_the_position_is_trusted_by_state_and_error(
    state: State, error95_m: float, localized: bool, reason: str | None
) -> None:
    told = said(encoder("3.0"), pose_of(state=state, error95_m=error95_m))["state_part"]["state"]
    assert told["mobileRobotPosition"]["localized"] is localized
    if reason is None:
        assert told["errors"] == []
    else:
        assert told["errors"][0]["errorDescription"].startswith(reason)


@pytest.mark.parametrize(("sigma_deg", "localized"), [(5.0, True), (5.2, False)])
def test_the_heading_has_to_be_known_too(sigma_deg: float, localized: bool) -> None:
    covariance = (0.01, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, math.radians(sigma_deg) ** 2)
    told = said(encoder("2.1"), pose_of(covariance=covariance))["state_part"]["state"]
    assert told["agvPosition"]["positionInitialized"] is localized
    reasons = [error["errorDescription"] for error in told["errors"]]
    said_so = ["localized: the heading error is up to 10.2 deg, more than 10 deg"]
    assert reasons == ([] if localized else said_so)


EXAMPLES = re.findall(
    r"^`(\w+)` (2\.1|3\.0)[^\n]*\n```json\n(.*?)```$",
    (REPO / "docs/vda5050.md").read_text(),
    re.M | re.S,
)


@pytest.mark.parametrize(("kind", "version", "text"), EXAMPLES)
def test_the_messages_of_the_page_are_valid(kind: str, version: Version, text: str) -> None:
    validate(version, kind, json.loads(text))


def test_the_page_shows_every_kind_in_both_versions() -> None:
    kinds = ("visualization", "state_part", "action_states", "instant_actions")
    shown = {(kind, version) for kind, version, _ in EXAMPLES}
    assert shown == {(kind, version) for kind in kinds for version in VERSIONS}


@derandomized
@given(stamp_s=st.floats(0.0, 4e9))
def test_timestamps_are_the_stamp_to_the_nearest_ms(stamp_s: float) -> None:
    text = timestamp(stamp_s)
    assert len(text) == 24
    assert abs(datetime.fromisoformat(text).timestamp() - stamp_s) <= 0.000501


def test_every_fifth_pose_goes_out_and_each_that_brings_news() -> None:
    made = encoder("3.0", pose_hz=50.0)
    sent = [seq for seq in range(21) if "visualization" in said(made, pose_of(seq=seq))]
    assert sent == [0, 5, 10, 15, 20]
    news: list[dict[str, Any]] = [
        {"state": State.LOST},
        {"state": State.LOST},
        {"state": State.AMBIGUOUS},
        {},
        {"epoch": 3},
        {"epoch": 3, "map": None},
    ]
    headers = [said(made, pose_of(**change)).get("visualization") for change in news]
    assert [bool(header) for header in headers] == [True, False, False, True, True, True]
    assert [header["headerId"] for header in headers if header] == [5, 6, 7, 8]


@pytest.mark.parametrize(("pose_hz", "asked_hz", "every"), [(50, 10, 5), (50, 8, 7), (20, 50, 1)])
def test_never_more_often_than_asked_for(pose_hz: float, asked_hz: float, every: int) -> None:
    made = encoder(pose_hz=pose_hz, visualization_hz=asked_hz)
    sent = [seq for seq in range(30) if said(made, pose_of(seq=seq))]
    assert sent == list(range(0, 30, every))


def test_sequence_and_epoch_go_along_beside_the_message() -> None:
    first, second = encoder("2.1").pose(pose_of(seq=9, epoch=4))
    assert first.key == "uagv/v2/acme/amr7/visualization"
    assert json.loads(first.attachment or b"") == {"v": 1, "seq": 9, "epoch": 4}
    assert second.key == "amr/amr7/vda5050/v2/state_part"
    assert second.attachment is None


@BOTH
def test_maps_go_by_name_where_the_layout_does(version: Version) -> None:
    made = encoder(version, map_id="name")
    assert said(made, pose_of()) == {}, "the name is not known yet"
    assert said(made, pose_of(map=None))["visualization"][POSITION[version]]["mapId"] == ""
    made.status(status_of())
    told = said(made, pose_of())
    assert told["visualization"][POSITION[version]]["mapId"] == "hall"
    (active,) = told["state_part"]["state"]["maps"]
    assert (active["mapId"], active["mapVersion"]) == ("hall", MAP_ID)
    other = "0" * 36
    assert said(made, pose_of(map=other)) == {}, "a new map, and still the old one's name"


def test_visualization_refers_to_the_newest_state_of_the_vehicle_controller() -> None:
    made = encoder("3.0")
    (inlet,) = made.inlets
    assert inlet.key == "uagv/v3/acme/amr7/state"
    assert inlet.decode(b'{"headerId": 4711, "orderId": "", "errors": [{}]}') is None
    for wrong in (b"{}", b'{"headerId": -1}', b'{"headerId": 4294967296}', b'{"headerId": "1"}'):
        with pytest.raises(WireError, match=r"^headerId: "):
            inlet.decode(wrong)
    assert said(made, pose_of())["visualization"]["referenceStateHeaderId"] == 4711
    assert encoder("2.1").inlets == []


def test_both_versions_at_once_say_the_same() -> None:
    chosen = Vda5050Settings(versions=("2.1", "3.0"), manufacturer="acme", serial_number="00:17")
    both = encoders(chosen, prefix="amr", robot="amr7", pose_hz=10.0)
    told = [said(one, pose_of()) for one in both]
    keys = [encoded.key for one in both for encoded in one.pose(pose_of(seq=1))]
    assert keys[0] == "uagv/v2/acme/00:17/visualization"
    assert keys[2] == "uagv/v3/acme/00:17/visualization"
    first, second = (one["visualization"] for one in told)
    assert first["timestamp"] == second["timestamp"]
    for field in ("x", "y", "theta", "mapId", "localizationScore", "deviationRange"):
        assert first["agvPosition"][field] == second["mobileRobotPosition"][field]


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ('versions = ["2.1"]', "vda5050: manufacturer is missing: it is part of every topic"),
        ('versions = ["2.0"]', r"vda5050.versions.*: .*'2.1' or '3.0'"),
        ('versions = ["3.0", "3.0"]', "vda5050: versions should name each version once"),
        ('manufacturer = "a/b"', "vda5050: manufacturer should be 1 to 64 letters"),
        ('interface = "uagv/#"', "vda5050: interface should be 1 to 64 letters"),
        ('serial_number = "*"', "vda5050: serial_number should be 1 to 64 letters"),
        ("visualization_hz = 0.0", "vda5050.visualization_hz: should be greater than or equal to"),
        ("take_radius_m = 11.0", "vda5050.take_radius_m: should be less than or equal to 10"),
    ],
)
def test_what_makes_no_topic_or_no_sense_is_refused(lines: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse(tomllib.loads(f"{ROBOT}\n[vda5050]\n{lines}\n"))


def test_it_is_off_unless_switched_on() -> None:
    assert encoders(parse(tomllib.loads(ROBOT)).vda5050, prefix="a", robot="b", pose_hz=50) == []
