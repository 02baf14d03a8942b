"""The published schemas are the models', and what is sent validates by them."""

from __future__ import annotations

import copy
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from messages import pose_of, status_of
from paths import REPO
from test_publishing import free_endpoint, session

from amr_slam.publishing import RobotPublisher
from amr_slam.wire import ZenohSettings, command_of, json_schemas

DEADLINE_S = 20.0
EXAMPLES = dict(
    re.findall(r"^`(\w+)`\n```json\n(.*?)```$", (REPO / "docs/wire.md").read_text(), re.M | re.S)
)


def validate(kind: str, message: Any) -> None:
    schema = json.loads((REPO / "docs/schemas" / f"{kind}.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(message)


def test_the_schema_files_are_up_to_date(tmp_path: Path) -> None:
    tool = [sys.executable, str(REPO / "tools/schemas.py"), str(tmp_path)]
    subprocess.run(tool, check=True, capture_output=True)
    made = {path.name: path.read_text() for path in tmp_path.iterdir()}
    kept = {path.name: path.read_text() for path in (REPO / "docs/schemas").glob("*.json")}
    assert made == kept, "run python tools/schemas.py"


def test_every_payload_has_an_example_that_validates() -> None:
    assert set(EXAMPLES) == set(json_schemas())
    for kind, text in EXAMPLES.items():
        validate(kind, json.loads(text))


def test_messages_as_they_arrive_validate() -> None:
    endpoint = free_endpoint()
    with (
        RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot,
        session("client", connect=[endpoint]) as controller,
    ):
        robot.publish_pose(pose_of(fault="front: standby"))
        robot.publish_status(status_of(explained=0.9))
        for kind in ("pose", "status"):
            (reply,) = controller.get(f"amr/amr7/{kind}", timeout=DEADLINE_S)
            assert reply.ok is not None
            validate(kind, json.loads(reply.ok.payload.to_bytes()))


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("pose", {"v": 2}),
        ("pose", {"theta": 3.5}),
        ("pose", {"covariance": [0.0] * 8}),
        ("pose", {"state": "fine"}),
        ("status", {"explained": 1.5}),
        ("scan", {"points": [[1.0]]}),
        ("map_image", {"width_px": 0}),
        ("map_changes", {"changes": [{"number": 1, "what": "moved"}]}),
        ("set_pose", {"radius": 0.0}),
        ("set_pose", {"raduis": 1.0}),
        ("reply", {"ok": "yes"}),
    ],
)
def test_what_the_models_refuse_the_schemas_refuse(kind: str, change: dict[str, Any]) -> None:
    damaged = copy.deepcopy(json.loads(EXAMPLES[kind])) | change
    with pytest.raises(jsonschema.ValidationError):
        validate(kind, damaged)


def test_the_commands_of_the_page_are_taken() -> None:
    for kind in set(EXAMPLES) - {"pose", "status", "scan", "map_image", "map_changes", "reply"}:
        assert command_of(kind, EXAMPLES[kind].encode()).kind == kind
