"""ROS 2's keys, attachments and tokens on real sessions, read as its own programs read them."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
import zenoh
import zenoh.ext
from messages import pose_of, status_of
from ros2_bytes import deserialized, loop_that_draws, picture_of, ros_pose, serialized
from test_publishing import free_endpoint, repeat_until, session

from amr_slam.encodings import Lane
from amr_slam.encodings.ros2 import Ros2Encoder, Ros2Settings
from amr_slam.encodings.ros2.keys import (
    DIAGNOSTICS,
    GRID,
    ODOMETRY,
    POINTS,
    POSE,
    TRANSFORMS,
    Type,
    attachment,
    gid,
)
from amr_slam.geometry import Pose2
from amr_slam.publishing import RobotPublisher
from amr_slam.samples import State
from amr_slam.serving import Asked, telling
from amr_slam.wire import CommandReply, MapPart, ScanMessage, SetPose, ZenohSettings

INSTANCE = b"a run"
BOTH = Ros2Settings(plain=True, rmw_zenoh=True, initialpose=True)
POSE_HASH = "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
POSE_DDS = "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"
RMW_POSE = f"0/amr7/pose/{POSE_DDS}/{POSE_HASH}"
RMW_INITIALPOSE = f"0/amr7/initialpose/{POSE_DDS}/{POSE_HASH}"


def encoder(**changes: Any) -> Ros2Encoder:
    fields: dict[str, Any] = {"plain": True, "rmw_zenoh": True} | changes
    return Ros2Encoder(Ros2Settings(**fields), "amr7", INSTANCE)


@contextmanager
def robot(
    endpoint: str, settings: Ros2Settings = BOTH, **zenoh_settings: Any
) -> Iterator[RobotPublisher]:
    network = ZenohSettings(**({"listen": (endpoint,)} | zenoh_settings))
    with RobotPublisher(network, "amr7", [Ros2Encoder(settings, "amr7", INSTANCE)]) as publisher:
        yield publisher


def scan_of(seq: int = 0) -> ScanMessage:
    points = ((1.0, 2.0), (3.5, -4.25))
    return ScanMessage(
        robot="amr7", seq=seq, stamp=1_790_000_000.0, map=None, epoch=2, points=points
    )


def pose2(transform: Any) -> Pose2:
    """Of a geometry_msgs/Transform."""
    turn = transform.rotation
    return Pose2(transform.translation.x, transform.translation.y, 2.0 * math.atan2(turn.z, turn.w))


def sent(encoder: Ros2Encoder, **changes: Any) -> dict[str, bytes]:
    return {one.key: one.payload for one in encoder.pose(pose_of(**changes))}


# -- what is made


def test_the_keys_are_those_of_the_bridge_and_of_rmw_zenoh() -> None:
    keys = {outlet.key: outlet for outlet in encoder().outlets}
    plain = [key for key in keys if key.startswith("amr7/")]
    topics = ["pose", "odom", "tf", "scan_points", "diagnostics", "map"]
    assert plain == [f"amr7/{topic}" for topic in topics]
    assert len(keys) == 2 * len(topics)
    assert RMW_POSE in keys
    assert keys[RMW_POSE].encoding == "application/cdr;geometry_msgs/msg/PoseWithCovarianceStamped"
    assert keys["amr7/tf"].lane is Lane.POSE
    assert keys["amr7/scan_points"].lane is Lane.SCAN
    assert keys["amr7/diagnostics"].lane is Lane.STATUS
    only_plain = encoder(rmw_zenoh=False)
    assert [outlet.key for outlet in only_plain.outlets] == plain
    assert not only_plain.tokens("abc")
    assert not only_plain.inlets


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"namespace": ""}, f"0/pose/{POSE_DDS}/{POSE_HASH}"),
        ({"namespace": "hall/one"}, f"0/hall/one/pose/{POSE_DDS}/{POSE_HASH}"),
        ({"domain": 7}, f"7/amr7/pose/{POSE_DDS}/{POSE_HASH}"),
        ({"type_hashes": False}, f"0/amr7/pose/{POSE_DDS}/TypeHashNotSupported"),
    ],
)
def test_namespace_domain_and_hash_are_as_configured(changes: dict[str, Any], key: str) -> None:
    made = encoder(**changes)
    assert key in [outlet.key for outlet in made.outlets]
    assert key in sent(made)
    if "namespace" in changes:
        start = f"{changes['namespace']}/".lstrip("/")
        assert f"{start}tf" in sent(made)


def test_all_that_is_made_has_an_outlet() -> None:
    made = encoder()
    keys = {outlet.key for outlet in made.outlets}
    encoded = [*made.pose(pose_of()), *made.status(status_of()), *made.scan(scan_of())]
    encoded += made.map(picture_of())
    assert {one.key for one in encoded} == keys


def test_the_attachment_is_as_zenoh_serializes_it() -> None:
    publisher = gid("amr7/pose", INSTANCE)
    ours = attachment(-3, 1_790_000_000_123_456_789, publisher)
    fields = (zenoh.ext.Int64(-3), zenoh.ext.Int64(1_790_000_000_123_456_789), publisher)
    assert ours == zenoh.ext.z_serialize(fields).to_bytes()
    assert len(ours) == 33


def test_each_publisher_of_each_run_has_an_identifier_of_its_own() -> None:
    one, other = encoder(), Ros2Encoder(BOTH, "amr7", b"another run")
    found = {
        encoded.attachment[-16:]
        for made in (one, other)
        for encoded in made.pose(pose_of())
        if encoded.attachment is not None
    }
    assert len(found) == 2 * 3  # pose, odom, tf


def test_the_transforms_lead_from_the_map_over_the_wheels_to_the_robot() -> None:
    message = pose_of()
    read = deserialized(TRANSFORMS, sent(encoder())["amr7/tf"])
    links = {(t.header.frame_id, t.child_frame_id): t for t in read.transforms}
    assert set(links) == {("map", "odom"), ("odom", "base_footprint")}
    map_from_odom = pose2(links["map", "odom"].transform)
    odom_from_base = pose2(links["odom", "base_footprint"].transform)
    assert odom_from_base == Pose2(4.0, 5.0, -1.0)
    found = map_from_odom @ odom_from_base
    assert (found.x_m, found.y_m, found.theta_rad) == pytest.approx(
        (message.x, message.y, message.theta)
    )
    for link in links.values():
        stamp = link.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(message.stamp, abs=1e-6)


def test_without_a_frame_of_the_wheels_the_robot_stands_in_the_map() -> None:
    made = encoder(odom_frame="", map_frame="hall", base_frame="amr7/base_link")
    read = deserialized(TRANSFORMS, sent(made)["amr7/tf"])
    (link,) = read.transforms
    assert (link.header.frame_id, link.child_frame_id) == ("hall", "amr7/base_link")
    assert pose2(link.transform) == Pose2(1.5, -2.25, 0.5)
    assert "amr7/odom" not in [outlet.key for outlet in made.outlets]
    assert not [key for key in sent(made) if "odom" in key]


@pytest.mark.parametrize(
    ("state", "known"),
    [
        (State.LOCALIZED, True),
        (State.MAPPING, True),
        (State.ODOMETRY_ONLY, True),
        (State.STARTING, False),
        (State.LOST, False),
        (State.AMBIGUOUS, False),
    ],
)
def test_a_place_in_the_map_that_nobody_may_drive_by_is_withheld(state: State, known: bool) -> None:
    payloads = sent(encoder(), state=state)
    read = deserialized(TRANSFORMS, payloads["amr7/tf"])
    children = {t.child_frame_id for t in read.transforms}
    assert children == ({"odom", "base_footprint"} if known else {"base_footprint"})
    assert ("amr7/pose" in payloads) is known
    assert (RMW_POSE in payloads) is known
    assert "amr7/odom" in payloads
    direct = sent(encoder(odom_frame=""), state=state)
    assert ("amr7/tf" in direct) is known


def test_a_clock_beyond_ros_stops_nothing() -> None:
    assert not list(encoder().pose(pose_of(stamp=2.0**31)))
    assert not list(encoder().status(status_of(stamp=2.0**31)))


# -- what arrives

ARRIVING: list[tuple[str, Type, zenoh.Priority]] = [
    ("amr7/pose", POSE, zenoh.Priority.REAL_TIME),
    ("amr7/odom", ODOMETRY, zenoh.Priority.REAL_TIME),
    ("amr7/tf", TRANSFORMS, zenoh.Priority.REAL_TIME),
    ("amr7/scan_points", POINTS, zenoh.Priority.BACKGROUND),
    ("amr7/diagnostics", DIAGNOSTICS, zenoh.Priority.INTERACTIVE_LOW),
]


def test_everything_arrives_dropping_and_is_decoded_by_another_library() -> None:
    endpoint = free_endpoint()
    seen: dict[str, zenoh.Sample] = {}
    with robot(endpoint) as publisher, session("client", connect=[endpoint]) as other:
        for key in ("amr7/*", "0/**"):
            other.declare_subscriber(key, lambda s: seen.update({str(s.key_expr): s}))

        def publish() -> None:
            publisher.publish_pose(pose_of(seq=9))
            publisher.publish_status(status_of(seq=3))
            publisher.publish_scan(scan_of(seq=4))

        repeat_until(publish, lambda: len(seen) == 10)
    for key, kind, priority in ARRIVING:
        topic = key.removeprefix("amr7/")
        rmw = f"0/{key}/{kind.dds_name}/RIHS01_{kind.hash}"
        plain, twin = seen[key], seen[rmw]
        payload = plain.payload.to_bytes()
        assert payload == twin.payload.to_bytes()
        read = deserialized(kind, payload)
        assert serialized(kind, read) == payload, topic
        for sample in (plain, twin):
            assert sample.priority == priority
            assert sample.congestion_control == zenoh.CongestionControl.DROP
            assert not sample.express
            assert str(sample.encoding) == f"application/cdr;{kind.package}/msg/{kind.name}"
            assert sample.attachment is not None
    found = deserialized(POSE, seen["amr7/pose"].payload.to_bytes())
    assert found.header.frame_id == "map"
    assert (found.pose.pose.position.x, found.pose.pose.position.y) == (1.5, -2.25)
    assert found.pose.covariance[35] == 0.003
    beside = seen[RMW_POSE].attachment
    assert beside is not None
    seq, stamp_ns, publisher_gid = zenoh.ext.z_deserialize(
        tuple[zenoh.ext.Int64, zenoh.ext.Int64, bytes], beside
    )
    assert seq == 9
    assert stamp_ns == round(1e9 * pose_of(seq=9).stamp)
    assert publisher_gid == gid(RMW_POSE, INSTANCE)


def test_open_rmf_finds_the_robot_in_the_map_on_the_key_that_it_reads() -> None:
    """free_fleet subscribes to ``<robot>/tf`` and looks map -> base_footprint up in it."""
    endpoint = free_endpoint()
    seen: list[bytes] = []
    settings = Ros2Settings(plain=True)
    with robot(endpoint, settings) as publisher, session("client", connect=[endpoint]) as other:
        other.declare_subscriber("amr7/tf", lambda s: seen.append(s.payload.to_bytes()))
        repeat_until(lambda: publisher.publish_pose(pose_of()), lambda: bool(seen))
    read = deserialized(TRANSFORMS, seen[0])
    parents = {t.child_frame_id: (t.header.frame_id, pose2(t.transform)) for t in read.transforms}
    frame, found = "base_footprint", Pose2.identity()
    while frame != "map":
        frame, parent_from_child = parents[frame]
        found = parent_from_child @ found
    assert (found.x_m, found.y_m, found.theta_rad) == pytest.approx((1.5, -2.25, 0.5))


def test_the_graph_sees_node_publishers_and_subscription() -> None:
    endpoint = free_endpoint()
    with robot(endpoint) as publisher, session("client", connect=[endpoint]) as other:
        replies = other.liveliness().get("@ros2_lv/0/**", timeout=20.0)
        found = {str(reply.ok.key_expr) for reply in replies if reply.ok}
        zid = str(publisher._session.zid())
    start, node = f"@ros2_lv/0/{zid}/0", "%/%amr7/amr_slam"
    end = f"{POSE_DDS}/{POSE_HASH}/::,10:,:,:,,"
    assert f"{start}/0/NN/{node}" in found
    assert f"{start}/1/MP/{node}/%amr7%pose/{end}" in found
    assert f"{start}/7/MS/{node}/%amr7%initialpose/{end}" in found
    assert len(found) == 1 + 6 + 1


def test_without_a_namespace_the_tokens_have_an_empty_one() -> None:
    node, publisher, *_ = encoder(namespace="").tokens("z")
    assert node == "@ros2_lv/0/z/0/0/NN/%/%/amr_slam"
    assert publisher.startswith("@ros2_lv/0/z/0/1/MP/%/%/amr_slam/%pose/geometry_msgs::")


def test_the_graph_forgets_a_robot_that_has_gone() -> None:
    endpoint = free_endpoint()
    seen: list[tuple[str, zenoh.SampleKind]] = []
    with opened(router(endpoint)), session("client", connect=[endpoint]) as other:
        listener = other.liveliness().declare_subscriber(
            "@ros2_lv/0/**", lambda s: seen.append((str(s.key_expr), s.kind)), history=True
        )
        with robot("", listen=(), connect=(endpoint,)):
            until(lambda: len(seen) == 8)
        until(lambda: len(seen) == 16)
        listener.undeclare()  # type: ignore[no-untyped-call]
    assert all(kind == zenoh.SampleKind.DELETE for _, kind in seen[8:])
    assert {key for key, _ in seen[:8]} == {key for key, _ in seen[8:]}


# -- how ROS 2's sessions reach the robot


def ros_session(mode: str, endpoint: str) -> dict[str, Any]:
    """What is not Zenoh's own default in rmw_zenoh's configuration of nodes."""
    own = {"listen/endpoints": ["tcp/localhost:0"]} if mode == "peer" else {}
    return {"mode": mode, "connect/endpoints": [endpoint], **GOSSIP, **own}


GOSSIP: dict[str, Any] = {
    "timestamping/enabled": True,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
    "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
}


@contextmanager
def opened(options: dict[str, Any]) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in options.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as found:
        yield found


def router(listen: str, connect: Sequence[str] = ()) -> dict[str, Any]:
    own = {"listen/endpoints": [listen], "connect/endpoints": list(connect)}
    return {"mode": "router", **GOSSIP, **own}


def directly(stack: ExitStack, mode: str) -> tuple[dict[str, Any], dict[str, Any]]:
    endpoint = free_endpoint()
    return {"listen": (endpoint,)}, ros_session(mode, endpoint)


def as_client_of_the_router(stack: ExitStack) -> tuple[dict[str, Any], dict[str, Any]]:
    endpoint = free_endpoint()
    stack.enter_context(opened(router(endpoint)))
    return {"listen": (), "connect": (endpoint,)}, ros_session("client", endpoint)


def by_a_router_of_its_own(stack: ExitStack) -> tuple[dict[str, Any], dict[str, Any]]:
    site, own = free_endpoint(), free_endpoint()
    stack.enter_context(opened(router(site)))
    stack.enter_context(opened(router(own, [site])))
    return {"listen": (), "connect": (site,)}, ros_session("peer", own)


@pytest.mark.parametrize(
    "way",
    [
        lambda stack: directly(stack, "client"),
        lambda stack: directly(stack, "peer"),
        as_client_of_the_router,
        by_a_router_of_its_own,
    ],
    ids=["client of the robot", "peer of the robot", "client of the router", "own router"],
)
def test_nodes_reach_the_robot_and_the_robot_the_nodes(
    way: Callable[[ExitStack], tuple[dict[str, Any], dict[str, Any]]],
) -> None:
    """rmw_zenoh's own kind of subscriber hears the robot, and its initial pose is heard."""
    seen: list[bytes] = []
    asked: list[Asked] = []

    def loop(one: Asked) -> None:
        asked.append(one)
        one.done(CommandReply(ok=True))

    with ExitStack() as stack:
        network, node = way(stack)
        publisher = stack.enter_context(robot("", **network))
        publisher.serve(loop)
        nodes = stack.enter_context(opened(node))
        subscriber = zenoh.ext.declare_advanced_subscriber(
            nodes, RMW_POSE, lambda s: seen.append(s.payload.to_bytes())
        )
        sequence = itertools.count()
        repeat_until(
            lambda: publisher.publish_pose(pose_of(seq=next(sequence))), lambda: len(seen) >= 3
        )
        place = serialized(POSE, ros_pose(5, "map", pose_of()))
        repeat_until(
            lambda: nodes.put(RMW_INITIALPOSE, place, attachment=attachment(1, 5, bytes(16))),
            lambda: bool(asked),
        )
        subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert isinstance(asked[0].request, SetPose)
    assert asked[0].by == "ros2 initialpose"


# -- the map, for those who come late


def test_the_map_is_drawn_once_and_given_to_late_subscribers_as_rmw_zenoh_has_them() -> None:
    endpoint = free_endpoint()
    drawn: list[Asked] = []
    seen: list[zenoh.Sample] = []
    key = f"0/amr7/map/{GRID.dds_name}/RIHS01_{GRID.hash}"
    with robot(endpoint) as publisher:
        publisher.serve(loop_that_draws(drawn))
        publisher.publish_status(status_of(map=None))
        for seq in range(3):  # the same map: drawn once
            publisher.publish_status(status_of(seq=seq))
        until(lambda: len(drawn) == 1)
        with session("client", connect=[endpoint]) as late:
            subscriber = zenoh.ext.declare_advanced_subscriber(
                late,
                key,
                seen.append,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
                recovery=zenoh.ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
                subscriber_detection=True,
            )
            until(lambda: len(seen) == 1)
            other_map = MapPart(id="0" * 36, name="other", version=1)
            publisher.publish_status(status_of(seq=4, map=other_map))
            until(lambda: len(seen) == 2)
            subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert len(drawn) == 2
    assert seen[1].congestion_control == zenoh.CongestionControl.BLOCK
    assert seen[1].priority == zenoh.Priority.DATA_LOW
    assert seen[1].attachment is not None
    read = deserialized(GRID, seen[0].payload.to_bytes())
    assert (read.info.width, read.info.height, read.info.resolution) == (3, 2, 0.5)
    assert (read.info.origin.position.x, read.info.origin.position.y) == (1.0, -2.0)
    assert read.data.tolist() == [0, 0, 100, -1, 0, 0]


def test_a_map_that_was_not_drawn_is_tried_again(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[Asked] = []

    def loop(asked: Asked) -> None:
        tried.append(asked)
        asked.not_done("the SLAM process has ended meanwhile")

    with robot(free_endpoint()) as publisher:
        publisher.serve(loop)
        publisher.publish_status(status_of())
        until(lambda: "the map was not drawn: the SLAM process has ended" in caplog.text)
        publisher.publish_status(status_of())
        assert len(tried) == 1  # not at once
        monkeypatch.setattr(telling, "_PERIOD_S", 0.0)
        repeat_until(lambda: publisher.publish_status(status_of()), lambda: len(tried) >= 2)


# -- what is taken in


@contextmanager
def serving(
    settings: Ros2Settings = BOTH, answer: Callable[[Asked], object] | None = None
) -> Iterator[tuple[RobotPublisher, zenoh.Session, list[Asked]]]:
    endpoint = free_endpoint()
    asked: list[Asked] = []

    def loop(one: Asked) -> None:
        asked.append(one)
        (answer or (lambda a: a.done(CommandReply(ok=True))))(one)

    with robot(endpoint, settings) as publisher:
        publisher.serve(loop)
        with session("client", connect=[endpoint]) as other:
            yield publisher, other, asked


def until(condition: Callable[[], bool]) -> None:
    repeat_until(lambda: None, condition)


def place(**changes: Any) -> bytes:
    return serialized(POSE, ros_pose(5, "map", pose_of(**changes)))


@pytest.mark.parametrize("key", ["amr7/initialpose", RMW_INITIALPOSE])
def test_an_initial_pose_on_either_key_is_the_command(key: str) -> None:
    with serving() as (publisher, other, asked):
        other.put(key, place(x=3.0, y=-1.0, theta=0.25))
        until(lambda: len(asked) == 1)
        command = asked[0].request
        assert isinstance(command, SetPose)
        assert (command.x, command.y) == (3.0, -1.0)
        assert command.theta == pytest.approx(0.25)
        assert command.radius == 0.5  # three sigmas would be 0.42 m
        assert publisher.refused == 0


def test_what_is_refused_is_counted_and_logged_and_never_asked(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with serving() as (publisher, other, asked):
        refused = [
            b"",
            b"junk",
            bytes(5000),
            place()[:-1],
            serialized(POSE, ros_pose(5, "odom", pose_of())),
        ]
        for count, payload in enumerate(refused, start=1):
            other.put("amr7/initialpose", payload)
            until(lambda count=count: publisher.refused == count)  # type: ignore[misc]
        other.delete("amr7/initialpose")
        until(lambda: publisher.refused == len(refused) + 1)
        assert asked == []
        assert "ros2 initialpose: refused: 5000 bytes, at most 4096" in caplog.text
        assert "in frame 'odom', not in 'map'" in caplog.text
        lines = len(caplog.records)
        for _ in range(50):
            other.put("amr7/initialpose", b"junk")
        until(lambda: publisher.refused == len(refused) + 51)
        assert len(caplog.records) - lines <= 3  # a sender of junk does not fill the log


def test_a_refusal_by_the_loop_is_counted_and_one_command_at_a_time_is_done() -> None:
    held: list[Asked] = []
    with serving(answer=held.append) as (publisher, other, asked):
        other.put("amr7/initialpose", place())
        until(lambda: len(held) == 1)
        other.put("amr7/initialpose", place())
        until(lambda: publisher.refused == 1)
        (reply,) = other.get("amr/amr7/cmd/relocalize", timeout=20.0)
        assert reply.ok is not None
        assert "another command is under way" in reply.ok.payload.to_string()
        held[0].not_done("nothing fits")
        until(lambda: publisher.refused == 2)
        assert len(asked) == 1


def test_where_it_is_not_switched_on_nothing_is_taken() -> None:
    settings = Ros2Settings(plain=True, rmw_zenoh=True)
    with serving(settings) as (publisher, other, asked):
        for key in ("amr7/initialpose", RMW_INITIALPOSE):
            other.put(key, place())
        (reply,) = other.get("amr/amr7/cmd/relocalize", timeout=20.0)  # later on the same link
        assert reply.ok is not None
        assert [type(one.request).__name__ for one in asked] == ["Relocalize"]
        assert publisher.refused == 0
