"""Instant actions of VDA 5050: which set the pose, which do not, and what is said of them."""

from __future__ import annotations

import json
import math
from typing import Any

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import MAP_ID, pose_of, status_of
from paths import REPO

from amr_slam.encodings import Encoder, Request
from amr_slam.encodings.vda5050 import Vda5050Settings, Version, encoders
from amr_slam.encodings.vda5050.actions import MAX_ACTIONS_BYTES
from amr_slam.wire import CommandReply, SetPose, WireError
from amr_slam.wire.commands import FoundPose

KIND = {"2.1": "initPosition", "3.0": "initializePosition"}
STATES = {"2.1": "actionStates", "3.0": "instantActionStates"}
RESULT = {"2.1": "resultDescription", "3.0": "actionResult"}
BOTH = pytest.mark.parametrize("version", ["2.1", "3.0"])


class Vehicle:
    """The encoder of one version, which has told of a map."""

    def __init__(self, version: Version = "3.0", **changes: Any) -> None:
        chosen = Vda5050Settings(
            versions=(version,), manufacturer="acme", take_position=True, **changes
        )
        (self.encoder,) = encoders(chosen, prefix="amr", robot="amr7", pose_hz=50.0)
        self.version = version
        self.inlet = self.encoder.inlets[-1]
        self.encoder.status(status_of())
        list(self.encoder.pose(pose_of()))

    def hears(self, *actions: dict[str, Any], **header: Any) -> Request | None:
        return self.inlet.decode(message(*actions, **header))

    def states(self) -> list[dict[str, Any]]:
        """Told with the next pose, which is not due itself."""
        told = states_of(self.encoder)
        if told is None:
            return []
        schema = json.loads((REPO / f"docs/schemas/vda5050/{self.version}.json").read_text())
        schema["$ref"] = "#/$defs/action_states"
        jsonschema.Draft202012Validator(schema).validate(told)
        states: list[dict[str, Any]] = told["state"][STATES[self.version]]
        return states


def states_of(encoder: Encoder) -> Any:
    for encoded in encoder.pose(pose_of()):
        if encoded.key.endswith("/action_states"):
            return json.loads(encoded.payload)
    return None


def message(*actions: dict[str, Any], **header: Any) -> bytes:
    whole = {
        "headerId": 1,
        "timestamp": "2026-09-21T14:13:20.125Z",
        "version": "3.0.0",
        "manufacturer": "acme",
        "serialNumber": "amr7",
    }
    return json.dumps({**whole, **header, "actions": actions}).encode()


def action(
    kind: str = "initializePosition", action_id: str = "a1", **changes: Any
) -> dict[str, Any]:
    position = {"x": 1.5, "y": -2, "theta": 0.5, "mapId": MAP_ID, "lastNodeId": "n7"} | changes
    return {
        "actionType": kind,
        "actionId": action_id,
        "blockingType": "NONE",
        "actionParameters": [{"key": key, "value": value} for key, value in position.items()],
    }


@BOTH
def test_a_position_becomes_a_search_around_it(version: Version) -> None:
    vehicle = Vehicle(version, take_radius_m=3.0)
    assert vehicle.inlet.key == f"uagv/v{version[0]}/acme/amr7/instantActions"
    request = vehicle.hears({"actionType": "startPause", "actionId": "p"}, action(KIND[version]))
    assert request is not None
    assert request.command == SetPose(x=1.5, y=-2.0, theta=0.5, radius=3.0)
    running = {"actionId": "a1", "actionType": KIND[version], "actionStatus": "RUNNING"}
    assert vehicle.states() == [running]
    assert vehicle.states() == [], "told once"
    assert request.answered is not None
    request.answered(CommandReply(ok=True, pose=FoundPose(x=1.25, y=-2.0, theta=0.5)))
    assert vehicle.states() == [
        running
        | {"actionStatus": "FINISHED", RESULT[version]: "found at x=1.250 y=-2.000 theta=0.5000"}
    ]


@BOTH
def test_why_it_failed_is_told(version: Version) -> None:
    vehicle = Vehicle(version)
    request = vehicle.hears(action(KIND[version]))
    assert request is not None
    assert request.answered is not None
    request.answered(CommandReply.refusing("set_pose: nothing fits"))
    (state,) = vehicle.states()
    assert (state["actionStatus"], state[RESULT[version]]) == ("FAILED", "set_pose: nothing fits")


def test_states_go_out_with_a_status_too_where_there_are_no_poses() -> None:
    vehicle = Vehicle()
    vehicle.hears(action())
    (encoded,) = vehicle.encoder.status(status_of())
    assert json.loads(encoded.payload)["state"]["instantActionStates"][0]["actionId"] == "a1"


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"x": "1.5"}, "x: Input should be a valid number"),
        ({"x": True}, "x: Input should be a valid number"),
        ({"y": None}, "y: Input should be a valid number"),
        ({"y": 1e6}, "y: Input should be less than or equal to 100000"),
        ({"theta": 3.2}, "theta: Input should be less than or equal to 3.14159265359"),
        ({"theta": -3.2}, "theta: Input should be greater than or equal to -3.14159265359"),
        ({"theta": [0.5]}, "theta: Input should be a valid number"),
        ({"mapId": "hall"}, f"mapId: hall: the active map is {MAP_ID}"),
        ({"mapId": ""}, "mapId: "),
        ({"mapId": 7}, "mapId: Input should be a valid string"),
    ],
)
def test_a_position_that_cannot_be_fails_and_says_why(
    changes: dict[str, Any], complaint: str
) -> None:
    vehicle = Vehicle()
    with pytest.raises(WireError) as refused:
        vehicle.hears(action(**changes))
    assert str(refused.value).startswith(complaint)
    (state,) = vehicle.states()
    assert (state["actionStatus"], state["actionResult"]) == ("FAILED", str(refused.value))


@pytest.mark.parametrize("missing", ["x", "y", "theta", "mapId"])
def test_a_missing_parameter_fails(missing: str) -> None:
    vehicle = Vehicle()
    damaged = action()
    damaged["actionParameters"] = [p for p in damaged["actionParameters"] if p["key"] != missing]
    with pytest.raises(WireError, match=f"^{missing}: Field required$"):
        vehicle.hears(damaged)
    assert vehicle.states()[0]["actionStatus"] == "FAILED"


def test_a_parameter_given_twice_and_two_positions_fail() -> None:
    vehicle = Vehicle()
    double = action()
    double["actionParameters"].append({"key": "x", "value": 2.0})
    with pytest.raises(WireError, match=r"^a parameter is given twice$"):
        vehicle.hears(double)
    with pytest.raises(WireError, match=r"^more than one position"):
        vehicle.hears(action(action_id="a2"), action(action_id="a3", x=2.0))
    assert [one["actionStatus"] for one in vehicle.states()] == ["FAILED"] * 3


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"[]",
        b"{",
        b"\xff",
        b"{}",
        b'{"actions": {}}',
        b'{"actions": [1]}',
        message({"actionType": "initializePosition"}),
        message({"actionType": "initializePosition", "actionId": ""}),
        message({"actionType": "initializePosition", "actionId": 7}),
        message(action(), manufacturer="other"),
        message(action(), serialNumber="amr8"),
        message(*[action("startPause", str(n)) for n in range(65)]),
        b'{"actions": ' + b"[" * 5000 + b"]" * 5000 + b"}",
        message(action()).replace(b"1.5", b"NaN"),
        message(action()).replace(b"1.5", b"1e999"),
    ],
)
def test_what_is_no_message_for_this_vehicle_does_nothing(payload: bytes) -> None:
    vehicle = Vehicle()
    with pytest.raises(WireError) as refused:
        vehicle.inlet.decode(payload)
    assert "\n" not in str(refused.value)
    assert {one["actionStatus"] for one in vehicle.states()} <= {"FAILED"}


@settings(derandomize=True, deadline=None, max_examples=200)
@given(payload=st.binary(max_size=200))
def test_junk_is_refused(payload: bytes) -> None:
    with pytest.raises(WireError):
        Vehicle().inlet.decode(payload)


numbers = st.floats() | st.integers() | st.booleans() | st.none() | st.text(max_size=5)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(x=numbers, y=numbers, theta=numbers)
def test_what_is_taken_is_finite_and_in_range(x: Any, y: Any, theta: Any) -> None:
    try:
        request = Vehicle().hears(action(x=x, y=y, theta=theta))
    except WireError:
        return
    assert request is not None
    command = request.command
    assert isinstance(command, SetPose)
    assert abs(command.x) <= 1e5
    assert abs(command.y) <= 1e5
    assert abs(command.theta) <= math.pi + 1e-9


def test_an_action_that_is_delivered_again_is_done_once() -> None:
    vehicle = Vehicle()
    assert vehicle.hears(action()) is not None
    assert vehicle.hears(action()) is None
    assert len(vehicle.states()) == 1
    assert vehicle.hears(action(action_id="a2")) is not None


def test_other_actions_are_the_vehicle_controllers() -> None:
    vehicle = Vehicle("3.0")
    assert vehicle.hears(action("cancelOrder"), action("initPosition", "a2")) is None
    assert vehicle.hears() is None
    assert vehicle.states() == []


def test_before_there_is_a_map_nothing_is_taken() -> None:
    vehicle = Vehicle()
    list(vehicle.encoder.pose(pose_of(map=None)))
    with pytest.raises(WireError, match="no map is active yet"):
        vehicle.hears(action())


def test_the_map_is_named_as_the_positions_name_it() -> None:
    vehicle = Vehicle(map_id="name")
    assert vehicle.hears(action(mapId="hall")) is not None
    with pytest.raises(WireError, match="the active map is hall"):
        vehicle.hears(action(action_id="a2"))
    list(vehicle.encoder.pose(pose_of(map="0" * 36)))  # another one, whose name is still to come
    with pytest.raises(WireError, match="no map is active yet"):
        vehicle.hears(action(action_id="a3", mapId="hall"))


def test_of_many_actions_the_last_are_told() -> None:
    vehicle = Vehicle()
    for number in range(300):
        vehicle.hears(action(action_id=str(number)))
    assert [one["actionId"] for one in vehicle.states()] == [str(n) for n in range(284, 300)]
    assert vehicle.hears(action(action_id="299")) is None
    assert vehicle.inlet.max_bytes == MAX_ACTIONS_BYTES


@BOTH
def test_nobody_is_listened_to_unless_switched_on(version: Version) -> None:
    chosen = Vda5050Settings(versions=(version,), manufacturer="acme")
    (made,) = encoders(chosen, prefix="amr", robot="amr7", pose_hz=50.0)
    assert not [inlet for inlet in made.inlets if inlet.key.endswith("instantActions")]
    assert not [outlet for outlet in made.outlets if outlet.key.endswith("action_states")]
