"""VDA 5050 from a real daemon: over Zenoh, through a bridge and a broker to an MQTT client."""

from __future__ import annotations

import json
import queue
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jsonschema
import numpy as np
import pytest
import zenoh
from daemon_rig import ROBOT, Daemon, Robot, until
from mqtt_rig import DEADLINE_S, Client, Message, bridge, broker
from paths import REPO

from amr_slam.encodings.vda5050.fields import timestamp
from amr_slam.wire import StatusMessage

VDA5050 = """
[vda5050]
versions = ["2.1", "3.0"]
manufacturer = "acme"
map_id = "name"
take_position = true
"""
TOPIC = {"2.1": "uagv/v2/acme/amr7", "3.0": "uagv/v3/acme/amr7"}
POSITION = {"2.1": "agvPosition", "3.0": "mobileRobotPosition"}
LOCALIZED = {"2.1": "positionInitialized", "3.0": "localized"}
KIND = {"2.1": "initPosition", "3.0": "initializePosition"}
RESULT = {"2.1": "resultDescription", "3.0": "actionResult"}


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    """One for all tests, in their order: it takes the longest to start."""
    folder = tmp_path_factory.mktemp("robot")
    with Robot(folder), Daemon(folder, edit=lambda text: text + VDA5050) as daemon:
        daemon.listen()
        yield daemon
        assert "Traceback" not in daemon.log()
        assert daemon.stop() == 0


def validate(version: str, kind: str, message: Any) -> None:
    schema = json.loads((REPO / f"docs/schemas/vda5050/{version}.json").read_text())
    schema["$ref"] = f"#/$defs/{kind}"
    jsonschema.Draft202012Validator(schema).validate(message)


class FleetControl:
    """Knows MQTT and VDA 5050, and nothing of Zenoh."""

    def __init__(self, port: int) -> None:
        self._heard: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self.client = Client(port, ["uagv/#"], self._heard.put)
        self._sent = 0

    def visualization(
        self, version: str, holds: Callable[[dict[str, Any]], bool] = lambda _: True
    ) -> dict[str, Any]:
        """The next one for which ``holds``."""
        while True:
            message = self._heard.get(timeout=DEADLINE_S)
            if message.topic == f"{TOPIC[version]}/visualization":
                told: dict[str, Any] = json.loads(message.payload)
                validate(version, "visualization", told)
                if holds(told):
                    return told

    def init_position(self, version: str, **position: Any) -> str:
        """The action's id."""
        self._sent += 1
        action_id = f"init-{version}-{self._sent}"
        action = {
            "actionType": KIND[version],
            "actionId": action_id,
            "blockingType": "NONE",
            "actionParameters": [{"key": key, "value": position[key]} for key in position],
        }
        whole = {
            "headerId": self._sent,
            "timestamp": "2026-09-21T14:13:20.000Z",
            "version": f"{version}.0",
            "manufacturer": "acme",
            "serialNumber": "amr7",
            "actions": [action],
        }
        self.client.publish(f"{TOPIC[version]}/instantActions", json.dumps(whole).encode())
        return action_id


class VehicleController:
    """On the vehicle: merges the parts of the state, by Zenoh."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session

    def state(self, version: str) -> dict[str, Any]:
        """What it merges into its own."""
        key = f"amr/{ROBOT}/vda5050/v{version[0]}/state_part"
        (reply,) = self.session.get(key, timeout=DEADLINE_S)
        assert reply.ok is not None
        part = json.loads(reply.ok.payload.to_bytes())
        validate(version, "state_part", part)
        state: dict[str, Any] = part["state"]
        return state

    def ended(self, version: str, action_id: str) -> dict[str, Any]:
        """The action's last state."""
        found: list[dict[str, Any]] = []

        def looks() -> bool:
            for reply in self.session.get(
                f"amr/{ROBOT}/vda5050/v{version[0]}/action_states", timeout=DEADLINE_S
            ):
                assert reply.ok is not None
                told = json.loads(reply.ok.payload.to_bytes())
                validate(version, "action_states", told)
                (states,) = told["state"].values()
                found.extend(
                    one
                    for one in states
                    if one["actionId"] == action_id and one["actionStatus"] != "RUNNING"
                )
            return bool(found)

        until(looks, f"{action_id} ends")
        return found[0]


@contextmanager
def everybody(daemon: Daemon) -> Iterator[tuple[FleetControl, VehicleController]]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([daemon.endpoint]))
    with zenoh.open(config) as session, broker() as port, bridge(daemon.endpoint, port, "uagv"):
        fleet_control = FleetControl(port)
        with fleet_control.client:
            yield fleet_control, VehicleController(session)


def in_map(name: str, scans: int = 1) -> Callable[[StatusMessage], bool]:
    return lambda s: s.map is not None and s.map.name == name and s.map.version >= scans


def command(session: zenoh.Session, kind: str, **arguments: Any) -> None:
    payload = json.dumps(arguments).encode()
    (reply,) = session.get(f"amr/{ROBOT}/cmd/{kind}", payload=payload, timeout=3 * DEADLINE_S)
    assert reply.ok is not None
    told = json.loads(reply.ok.payload.to_bytes())
    assert told["ok"], told


def test_every_version_is_the_same_pose_to_the_last_digit(daemon: Daemon) -> None:
    heard: dict[str, list[tuple[dict[str, Any], dict[str, Any]]]] = defaultdict(list)

    def on_sample(sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        which = json.loads(sample.attachment.to_bytes())
        heard[str(sample.key_expr)].append((which, json.loads(sample.payload.to_bytes())))

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([daemon.endpoint]))
    daemon.status_when(in_map("hall"), "the first map")
    with zenoh.open(config) as session:
        session.declare_subscriber("uagv/**", on_sample)
        poses = daemon.next_poses(200)
    by_seq = {pose.seq: pose for pose in poses}
    for version, topic in TOPIC.items():
        both = [(w, told) for w, told in heard[f"{topic}/visualization"] if w["seq"] in by_seq]
        assert len(both) >= 200 // 5 - 2
        ids = [told["headerId"] for _, told in both]
        assert ids == list(range(ids[0], ids[0] + len(both)))
        for which, told in both:
            pose = by_seq[which["seq"]]
            validate(version, "visualization", told)
            assert which["epoch"] == pose.epoch
            assert told["timestamp"] == timestamp(pose.stamp)
            position = told[POSITION[version]]
            assert (position["x"], position["y"], position["theta"]) == (
                pose.x,
                pose.y,
                pose.theta,
            )
            assert position["deviationRange"] == pose.error95_m
            assert position["mapId"] == "hall"
            assert told["velocity"] == {"vx": pose.vx, "omega": pose.omega}


def test_an_mqtt_client_reads_positions_and_sets_one(daemon: Daemon) -> None:
    daemon.status_when(in_map("hall", 15), "a map of a full turn")
    with everybody(daemon) as (fleet_control, vehicle):
        here = fleet_control.visualization("2.1")["agvPosition"]
        assert here["positionInitialized"]
        assert 0.0 < here["localizationScore"] <= 1.0
        action = fleet_control.init_position("2.1", x=0, y=0, theta=0.0, mapId="hall")
        assert "while mapping" in vehicle.ended("2.1", action)["resultDescription"]

        command(vehicle.session, "save_map", name="kept")
        command(vehicle.session, "load_map", name="kept")
        until(lambda: vehicle.state("3.0")["maps"][0]["mapId"] == "kept", "the loaded map")
        state = vehicle.state("2.1")
        assert state["agvPosition"]["positionInitialized"] is (state["errors"] == [])
        for version in TOPIC:
            told = fleet_control.visualization(
                version,
                lambda told, v=version: (
                    told[POSITION[v]][LOCALIZED[v]]  # type: ignore[misc]
                    and told[POSITION[v]]["mapId"] == "kept"
                ),
            )
            here = told[POSITION[version]]
            epoch = daemon.next_poses(1)[0].epoch
            about = {"theta": here["theta"], "mapId": "kept", "lastNodeId": "n1"}
            action = fleet_control.init_position(
                version, x=here["x"] + 0.5, y=here["y"] - 0.4, **about
            )
            ended = vehicle.ended(version, action)
            assert ended["actionStatus"] == "FINISHED", ended
            assert ended[RESULT[version]].startswith("found at x=")
            pose = daemon.next_poses(1)[0]
            assert pose.epoch == epoch + 1
            assert np.hypot(pose.x - here["x"], pose.y - here["y"]) < 0.2

        epoch = daemon.next_poses(1)[0].epoch
        refused = 0
        for wrong, reason in (
            ({"mapId": "hall"}, "the active map is kept"),
            ({"theta": 90.0}, "theta"),
            ({"x": "0"}, "x"),
            ({"x": 1e7}, "x"),
        ):
            position = {"x": 0.0, "y": 0.0, "theta": 0.0, "mapId": "kept"} | wrong
            action = fleet_control.init_position("3.0", **position)
            ended = vehicle.ended("3.0", action)
            assert ended["actionStatus"] == "FAILED"
            assert reason in ended["actionResult"]
            refused += 1
        for payload in (b"", b"{", b"\xff\xfe", b'{"actions": [{}]}', b" " * 20_000):
            fleet_control.client.publish(f"{TOPIC['3.0']}/instantActions", payload)
            refused += 1
        whole = json.dumps({"headerId": 4711, "orderId": ""}).encode()
        fleet_control.client.publish(f"{TOPIC['3.0']}/state", whole)
        fleet_control.visualization("3.0", lambda told: told["referenceStateHeaderId"] == 4711)
        # One of the tries while mapping came before them.
        daemon.status_when(lambda s: s.refused_requests == refused + 1, "all are counted")
        assert daemon.next_poses(1)[0].epoch == epoch
