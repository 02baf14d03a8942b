"""What Foxglove draws: recordings read with the mcap library, against Foxglove's own schemas."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from foxglove_official import check, official
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from messages import WELL, pose_of, status_of
from paths import REPO

from amr_slam import foxglove
from amr_slam.geometry import Pose2
from amr_slam.recording import RecordingWriter, read_log
from amr_slam.recording.messages import encode_published
from amr_slam.samples import Scan
from amr_slam.states import State
from amr_slam.wire import CandidatePart, HealthPart, PoseMessage, StatusMessage

START_NS = 5_000_000_000
MOUNTED = {"front": Pose2(0.3, 0.2, 0.7), "rear": Pose2(-0.3, -0.2, -2.4)}
Message = tuple[int, dict[str, Any]]


def recorded(path: Path, *messages: tuple[int, PoseMessage | StatusMessage]) -> None:
    """One scan, then the messages at their milliseconds."""
    scan = Scan(
        scanner="front",
        stamp_ns=START_NS,
        ranges_m=np.array([1.0, np.nan, np.inf, 2.5]),
        angle_min_rad=-1.0,
        angle_step_rad=0.5,
        sweep_s=0.03,
        seq=7,
    )
    with RecordingWriter(path, MOUNTED) as writer:
        writer.write(scan)
        for at_ms, message in messages:
            stamp_ns = START_NS + 1_000_000 * at_ms
            writer.add(encode_published(message.kind, stamp_ns, message.encode()))


def channels(path: Path) -> dict[str, tuple[str, list[Message]]]:
    """Schema and messages of each JSON topic, each message valid by the schema that the file
    gives it and, where that is one of Foxglove's, by Foxglove's own."""
    found: dict[str, tuple[str, list[Message]]] = {}
    validators: dict[int, Any] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            assert schema is not None
            if channel.message_encoding != "json":
                continue
            assert schema.encoding == "jsonschema"
            fields = json.loads(message.data)
            validators.setdefault(
                schema.id, jsonschema.Draft202012Validator(json.loads(schema.data))
            ).validate(fields)
            if schema.name.startswith("foxglove."):
                own = official(schema.name)
                known = {key: fields[key] for key in fields if key in own["properties"]}
                check(schema.name, known)
                if channel.topic not in {"/scan/front", "/truth"}:  # these hold more
                    assert known == fields
            found.setdefault(channel.topic, (schema.name, []))[1].append((message.log_time, fields))
    return found


def test_a_recording_has_what_foxglove_draws_and_replays_as_before(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    poses = [(20 * k, pose_of(seq=k, x=0.01 * k)) for k in range(50)]
    recorded(path, *poses, (1000, status_of()))
    found = channels(path)
    assert {topic: schema for topic, (schema, _) in found.items()} == {
        "/scan/front": "foxglove.LaserScan",
        "/tf_static": "foxglove.FrameTransforms",
        "/tf": "foxglove.FrameTransforms",
        "/scene": "foxglove.SceneUpdate",
        "/health": "foxglove.Log",
        "/pose": "amr_slam.PoseMessage",
        "/status": "amr_slam.StatusMessage",
    }
    ((_, mounted),) = found["/tf_static"][1]
    frames = {one["child_frame_id"]: one for one in mounted["transforms"]}
    assert frames.keys() == MOUNTED.keys()
    assert {one["parent_frame_id"] for one in frames.values()} == {"base"}
    assert found["/scan/front"][1][0][1]["frame_id"] == "front"
    assert frames["rear"]["translation"] == {"x": -0.3, "y": -0.2, "z": 0.0}
    assert 2.0 * math.atan2(frames["rear"]["rotation"]["z"], frames["rear"]["rotation"]["w"]) == (
        pytest.approx(-2.4)
    )
    # Ten of the fifty poses of this second, each as it was published.
    assert [stamp for stamp, _ in found["/tf"][1]] == [
        START_NS + 100_000_000 * k for k in range(10)
    ]
    for k, (_, moved) in enumerate(found["/tf"][1]):
        (one,) = moved["transforms"]
        assert (one["parent_frame_id"], one["child_frame_id"]) == ("map", "base")
        assert one["translation"]["x"] == pytest.approx(0.05 * k)
    # What replays is what was recorded, no more.
    (sample,) = read_log(path).samples
    assert isinstance(sample, Scan)
    assert sample.seq == 7


def test_a_simulated_recording_shows_the_truth(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with RecordingWriter(path, MOUNTED) as writer:
        writer.write_truth(START_NS, Pose2(1.0, 2.0, 0.5))
    ((_, moved),) = channels(path)["/tf"][1]
    assert moved["transforms"][0]["translation"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert moved["transforms"][0]["parent_frame_id"] == "map"


def test_health_is_said_once_and_then_when_it_changes(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    lost = HealthPart(link="LOST", age_s=3.0, rate_hz=0.0, samples=9, errors=4, detail="no answer")
    recorded(
        path,
        (0, status_of()),
        (1000, status_of()),
        (2000, status_of(scanners={"front": lost, "rear": WELL}, fault="front is silent")),
        (3000, status_of(scanners={"front": lost, "rear": WELL}, fault="front is silent")),
        (4000, status_of(state=State.LOST)),
    )
    said = [
        (stamp - START_NS, line["level"], line["name"], line["message"])
        for stamp, line in channels(path)["/health"][1]
    ]
    assert said == [
        (0, 2, "amr7", "state: localized"),
        (2_000_000_000, 4, "amr7", "front: LOST: no answer"),
        (2_000_000_000, 3, "amr7", "fault: front is silent"),
        (4_000_000_000, 4, "amr7", "state: lost"),
        (4_000_000_000, 2, "amr7", "front: OK"),
        (4_000_000_000, 2, "amr7", "fault is over"),
    ]


def test_places_of_an_ambiguous_robot_are_in_the_scene(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    places = (
        CandidatePart(x=1.0, y=2.0, theta=0.0, odds=0.6),
        CandidatePart(x=-4.0, y=2.0, theta=3.0, odds=0.3),
    )
    recorded(path, (0, status_of(state=State.AMBIGUOUS, candidates=places)))
    ((_, update),) = channels(path)["/scene"][1]
    (drawn,) = update["entities"]
    assert [arrow["pose"]["position"]["x"] for arrow in drawn["arrows"]] == [1.0, -4.0]
    assert [text["text"] for text in drawn["texts"]] == ["amr7? 60%", "amr7? 30%"]


# Standard deviations in m along and across, and the ellipse's direction in rad.
_SIGMAS = st.floats(1e-4, 50.0)


@settings(max_examples=50, deadline=None)
@given(along=_SIGMAS, across=_SIGMAS, theta=st.floats(-3.0, 3.0))
def test_the_ellipse_is_that_of_the_covariance(along: float, across: float, theta: float) -> None:
    turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
    covariance = np.diag([0.0, 0.0, 0.01])
    covariance[:2, :2] = turn @ np.diag([along**2, across**2]) @ turn.T
    pose = json.loads(pose_of(covariance=tuple(covariance.ravel())).encode())
    scene = foxglove.Robot(name="amr7", base_frame="base").scene(START_NS, pose)
    check("foxglove.SceneUpdate", scene)
    (ellipse,) = scene["entities"][0]["cylinders"]
    assert ellipse["pose"]["position"]["x"] == 1.5
    quaternion = ellipse["pose"]["orientation"]
    angle = 2.0 * math.atan2(quaternion["z"], quaternion["w"])
    # Points on its rim are on the contour of 95 %.
    unit = np.array([[1.0, 0.0], [0.0, 1.0], [math.sqrt(0.5), math.sqrt(0.5)]])
    rim = 0.5 * unit * [ellipse["size"]["x"], ellipse["size"]["y"]]
    rim = rim @ np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    inverse = turn @ np.diag([along**-2, across**-2]) @ turn.T
    assert np.einsum("ni,ij,nj->n", rim, inverse, rim) == pytest.approx(5.991, rel=1e-3)


def test_a_robot_that_knows_nothing_has_no_ellipse() -> None:
    pose = json.loads(
        pose_of(state=State.LOST, covariance=(1e9, *[0.0] * 7, 9.9), error95_m=1e9).encode()
    )
    scene = foxglove.Robot(name="amr7", base_frame="base").scene(START_NS, pose)
    check("foxglove.SceneUpdate", scene)
    (drawn,) = scene["entities"]
    assert drawn["cylinders"] == []
    assert drawn["texts"][0]["text"] == "amr7: lost ± ?"


@pytest.mark.parametrize("name", ["recording", "live"])
def test_layouts_show_topics_that_there_are(name: str) -> None:
    layout = json.loads((REPO / "config" / "foxglove" / f"{name}.json").read_text())
    panels = layout["configById"]

    def leaves(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    shown = {
        *panels["3D!map"]["topics"],
        panels["RosOut!health"]["topicToRender"],
        panels["RawMessages!status"]["topicPath"],
        *(path.split(".")[0] for path in paths),
    }
    if name == "live":
        leaf = ("scene", "scan", "health", "status", "pose")
        assert shown == {"/map/hall", *(f"/amr7/{one}" for one in leaf)}
    else:
        assert shown == {
            *("/map", "/scene", "/scan/front", "/scan/rear"),
            *("/health", "/status", "/pose"),
        }
    fields = {"pose": pose_of(), "status": status_of()}
    for path in paths:
        topic, *keys = path.removeprefix("/amr7").removeprefix("/").split(".")
        value: Any = json.loads(fields[topic].encode())
        for key in keys:
            value = value[key]
        assert isinstance(value, float | int | str)
