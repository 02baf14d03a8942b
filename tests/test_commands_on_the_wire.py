"""Arguments and replies of commands: what is taken, and how the rest is refused."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from amr_slam.wire import (
    COMMANDS,
    MAX_COMMAND_BYTES,
    CommandReply,
    LoadMap,
    MapPart,
    Relocalize,
    ResumePose,
    SaveMap,
    SaveRecording,
    SetPose,
    StartMapping,
    WireError,
    command_key,
    command_of,
)

derandomized = settings(derandomize=True, deadline=None, max_examples=100)
GOOD = [
    ("set_pose", {"x": 1, "y": -2.5, "theta": math.pi, "radius": 3}, SetPose),
    ("resume_pose", {"x": 1.0, "y": 2.0, "theta": -math.pi}, ResumePose),
    ("relocalize", {}, Relocalize),
    ("start_mapping", {"name": "hall-3"}, StartMapping),
    ("start_mapping", {"name": "hall-3", "extend": True, "hold": False}, StartMapping),
    ("save_map", {"name": "hall.v2"}, SaveMap),
    ("load_map", {"name": "Hall_3"}, LoadMap),
    ("save_recording", {"reason": "near-miss_2"}, SaveRecording),
]


@pytest.mark.parametrize(("name", "arguments", "kind"), GOOD)
def test_each_command_of_the_contract_takes_its_arguments(
    name: str, arguments: dict[str, Any], kind: type
) -> None:
    command = command_of(name, json.dumps(arguments).encode())
    assert isinstance(command, kind)
    assert command.model_dump(exclude={"v"}, exclude_unset=True) == arguments
    assert command_of(name, command.encode()) == command


def test_these_are_all_commands() -> None:
    assert list(COMMANDS) == list(dict.fromkeys(name for name, _, _ in GOOD))
    assert command_key("amr", "amr7", "set_pose") == "amr/amr7/cmd/set_pose"


def test_no_payload_is_no_arguments() -> None:
    assert command_of("relocalize", b"") == Relocalize()
    with pytest.raises(WireError, match=r"^save_map: name: Field required$"):
        command_of("save_map", b"")


def pose(**changes: object) -> bytes:
    return json.dumps({"x": 0.0, "y": 0.0, "theta": 0.0, "radius": 1.0} | changes).encode()


@pytest.mark.parametrize(
    ("name", "payload", "complaint"),
    [
        ("reboot", b"{}", "reboot: no such command; there are set_pose, resume_pose, relocalize"),
        ("x" * 5000, b"{}", "xxx"),
        ("set_pose", pose(radius=0), "set_pose: radius: Input should be greater than 0"),
        ("set_pose", pose(radius=1e5), "set_pose: radius: Input should be less than or equal to"),
        ("set_pose", pose(radius=None), "set_pose: radius: Input should be a valid number"),
        ("set_pose", pose(x=math.nan), "set_pose: x: Input should be a finite number"),
        ("set_pose", pose(y=1e6), "set_pose: y: Input should be less than or equal to 100000"),
        ("set_pose", pose(x="1"), "set_pose: x: Input should be a valid number"),
        ("set_pose", pose(x=True), "set_pose: x: Input should be a valid number"),
        ("set_pose", pose(theta=90.0), "set_pose: theta: Input should be less than or equal to 6"),
        ("set_pose", pose(raduis=1.0), "set_pose: raduis: Extra inputs are not permitted"),
        ("set_pose", pose(**{"a\n" * 200: 1}), "set_pose: a a a"),
        ("set_pose", pose(v=2), "set_pose: v: Input should be 1"),
        ("resume_pose", pose(), "resume_pose: radius: Extra inputs are not permitted"),
        ("relocalize", b"[]", "relocalize: payload: Input should be an object"),
        ("relocalize", b"{", "relocalize: payload: Invalid JSON: "),
        ("relocalize", b" " * 5000, f"relocalize: 5000 bytes, at most {MAX_COMMAND_BYTES}"),
        ("save_map", b'{"name": "../hall"}', "save_map: name: should be 1 to 64 letters"),
        ("load_map", b'{"name": ".hall"}', "load_map: name: should be 1 to 64 letters"),
        ("start_mapping", b'{"name": "hall\\n"}', "start_mapping: name: should be 1 to 64"),
        ("start_mapping", b'{"name": ""}', "start_mapping: name: String should have at least 1"),
        ("save_recording", b'{"reason": "a/b"}', "save_recording: reason: should be 1 to 40"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line(
    name: str, payload: bytes, complaint: str
) -> None:
    with pytest.raises(WireError) as refused:
        command_of(name, payload)
    said = str(refused.value)
    assert said.startswith(complaint)
    assert "\n" not in said
    assert len(said) < 250
    assert CommandReply.refusing(refused.value).error == said


@derandomized
@given(name=st.sampled_from(sorted(COMMANDS)), payload=st.binary(max_size=100))
def test_junk_is_refused(name: str, payload: bytes) -> None:
    try:
        command = command_of(name, payload)
    except WireError:
        return
    assert command == Relocalize()
    assert payload.strip() in {b"", b"{}"}


def test_a_reply_says_what_became_of_the_command() -> None:
    done = CommandReply(ok=True, map=MapPart(id="0" * 36, name="hall", version=3))
    assert json.loads(done.encode()) == {
        "v": 1,
        "ok": True,
        "error": None,
        "pose": None,
        "map": {"id": "0" * 36, "name": "hall", "version": 3},
        "file": None,
    }
    assert CommandReply.decode(done.encode()) == done
    assert CommandReply.decode(b'{"ok": true, "error": null}') == CommandReply(ok=True)
    assert CommandReply.decode(b'{"ok": false, "error": "busy"}').error == "busy"


@pytest.mark.parametrize("fields", [{"ok": True, "error": "x"}, {"ok": False}, {"error": "x"}])
def test_an_error_belongs_to_what_was_not_done(fields: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        CommandReply(**fields)
    with pytest.raises(WireError, match=r"^reply: "):
        CommandReply.decode(json.dumps(fields).encode())


def test_a_refusal_is_one_bounded_line_whatever_went_wrong() -> None:
    assert CommandReply.refusing("").error == "failed"
    assert CommandReply.refusing(OSError("a\n  b")).error == "a b"
    assert CommandReply.refusing(OSError("\udcff.mcap")).encode()
    assert CommandReply.refusing("x" * 900).error == "x" * 500
    with pytest.raises(ValidationError) as caught:
        SetPose(x=0.0, y=0.0, theta=0.0, radius=-1.0)
    assert CommandReply.refusing(caught.value).error == "radius: Input should be greater than 0"
