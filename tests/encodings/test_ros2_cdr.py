"""Our CDR against an independent serializer, byte for byte, and what the reader refuses."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import MAP_ID, pose_of, status_of
from ros2_bytes import (
    STORE,
    covariance,
    deserialized,
    header,
    name_of,
    pose,
    quaternion,
    ros,
    ros_pose,
    serialized,
    vector,
)
from rosbags.typesys import Stores, get_typestore

from amr_slam.encodings import MapPicture
from amr_slam.encodings.ros2 import messages
from amr_slam.encodings.ros2.cdr import CdrReader, CdrWriter
from amr_slam.encodings.ros2.initialpose import read_initialpose
from amr_slam.encodings.ros2.keys import (
    DIAGNOSTICS,
    GRID,
    ODOMETRY,
    POINTS,
    POSE,
    TRANSFORMS,
    Type,
)
from amr_slam.encodings.ros2.messages import Header, Transform
from amr_slam.geometry import Pose2
from amr_slam.map.export import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    OccupancyImage,
    png_bytes,
    png_pixels,
)
from amr_slam.samples import State
from amr_slam.wire import (
    HealthPart,
    MapImage,
    PoseMessage,
    ScanMessage,
    SetPose,
    StatusMessage,
    WireError,
)

derandomized = settings(derandomize=True, deadline=None, max_examples=100)
HUMBLE = get_typestore(Stores.ROS2_HUMBLE)

Finite = st.floats(allow_nan=False, allow_infinity=False)
Metres = st.floats(-1e5, 1e5)
Angles = st.floats(-math.pi, math.pi, exclude_min=True)
Frames = st.text("abcdefghijklmnop_0123456789", min_size=1, max_size=20)
"""All lengths, so that each padding comes before the doubles."""
StampsNs = st.integers(0, (1 << 31) * 1_000_000_000 - 1)
Texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)


@st.composite
def pose_messages(draw: st.DrawFn) -> PoseMessage:
    return pose_of(
        x=draw(Metres),
        y=draw(Metres),
        theta=draw(Angles),
        vx=draw(Finite),
        omega=draw(Finite),
        covariance=tuple(draw(st.lists(Finite, min_size=9, max_size=9))),
        odom={"x": draw(Metres), "y": draw(Metres), "theta": draw(Angles)},
    )


@pytest.mark.parametrize("kind", [POSE, ODOMETRY, TRANSFORMS, DIAGNOSTICS, POINTS, GRID])
def test_the_hashes_are_those_of_the_definitions(kind: Type) -> None:
    assert STORE.hash_rihs01(name_of(kind)) == f"RIHS01_{kind.hash}"
    assert HUMBLE.hash_rihs01(name_of(kind)) == f"RIHS01_{kind.hash}"


def test_a_pose_has_the_size_that_is_known_of_it() -> None:
    assert len(messages.pose_with_covariance(Header(stamp_ns=1, frame="map"), pose_of())) == 364


@derandomized
@given(stamp_ns=StampsNs, frame=Frames, message=pose_messages())
def test_a_pose_is_byte_for_byte_that_of_another_serializer(
    stamp_ns: int, frame: str, message: PoseMessage
) -> None:
    ours = messages.pose_with_covariance(Header(stamp_ns=stamp_ns, frame=frame), message)
    assert ours == serialized(POSE, ros_pose(stamp_ns, frame, message))


@derandomized
@given(stamp_ns=StampsNs, frame=Frames, child=Frames, message=pose_messages())
def test_odometry_is_byte_for_byte_that_of_another_serializer(
    stamp_ns: int, frame: str, child: str, message: PoseMessage
) -> None:
    ours = messages.odometry(Header(stamp_ns=stamp_ns, frame=frame), child, message, 0.1, 0.2)
    odom = message.odom
    unknown = covariance(tuple(np.diag([1e6, 1e6, 1e6]).ravel()))
    speeds = covariance(tuple(np.diag([0.1**2, 0.1**2, 0.2**2]).ravel()))
    twist = ros(
        "geometry_msgs/msg/Twist",
        linear=vector(message.vx, 0.0, 0.0),
        angular=vector(0.0, 0.0, message.omega),
    )
    theirs = ros(
        name_of(ODOMETRY),
        header=header(stamp_ns, frame),
        child_frame_id=child,
        pose=ros(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=pose(odom.x, odom.y, odom.theta),
            covariance=unknown,
        ),
        twist=ros("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=speeds),
    )
    assert ours == serialized(ODOMETRY, theirs)


@derandomized
@given(
    several=st.lists(st.tuples(StampsNs, Frames, Frames, Metres, Metres, Angles), max_size=3),
)
def test_transforms_are_byte_for_byte_those_of_another_serializer(
    several: list[tuple[int, str, str, float, float, float]],
) -> None:
    ours = messages.transforms(
        [
            Transform(header=Header(stamp_ns=t, frame=f), child=c, pose=Pose2(x, y, theta))
            for t, f, c, x, y, theta in several
        ]
    )
    theirs = ros(
        name_of(TRANSFORMS),
        transforms=[
            ros(
                "geometry_msgs/msg/TransformStamped",
                header=header(t, f),
                child_frame_id=c,
                transform=ros(
                    "geometry_msgs/msg/Transform",
                    translation=vector(x, y, 0.0),
                    rotation=quaternion(theta),
                ),
            )
            for t, f, c, x, y, theta in several
        ],
    )
    assert ours == serialized(TRANSFORMS, theirs)


@derandomized
@given(stamp_ns=StampsNs, frame=Frames, points=st.lists(st.tuples(Metres, Metres), max_size=20))
def test_points_are_byte_for_byte_those_of_another_serializer(
    stamp_ns: int, frame: str, points: list[tuple[float, float]]
) -> None:
    scan = ScanMessage(
        robot="amr7", seq=1, stamp=1.0, map=None, epoch=0, points=tuple(points)
    )  # fmt: skip
    ours = messages.points(Header(stamp_ns=stamp_ns, frame=frame), scan)
    fields = [
        ros("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate("xyz")
    ]
    data = np.array([(x, y, 0.0) for x, y in points], dtype=np.float32).tobytes()
    theirs = ros(
        name_of(POINTS),
        header=header(stamp_ns, frame),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=np.frombuffer(data, dtype=np.uint8),
        is_dense=True,
    )
    assert ours == serialized(POINTS, theirs)


@derandomized
@given(
    stamp_ns=StampsNs,
    frame=Frames,
    rows=st.integers(1, 4),
    columns=st.integers(1, 5),
    left_px=st.floats(-1000.0, 1000.0),
    low_px=st.floats(-1000.0, 1000.0),
    data=st.data(),
)
def test_a_grid_is_byte_for_byte_that_of_another_serializer(
    stamp_ns: int,
    frame: str,
    rows: int,
    columns: int,
    left_px: float,
    low_px: float,
    data: st.DataObject,
) -> None:
    greys = st.sampled_from([OCCUPIED, UNKNOWN, FREE])
    drawn = data.draw(st.lists(greys, min_size=rows * columns, max_size=rows * columns))
    pixels = np.array(drawn, dtype=np.uint8).reshape(rows, columns)
    image = OccupancyImage(pixels=pixels, resolution_m=0.05, x_min_m=0.0, y_min_m=0.0)
    at = MapImage(
        map=MAP_ID,
        width_px=columns,
        height_px=rows,
        metres_per_px=0.05,
        column_of_x0_px=-left_px,
        row_of_y0_px=rows + low_px,
    )
    read_again = png_pixels(png_bytes(image))
    picture = MapPicture(seq=0, stamp=1.0, pixels=read_again, georeference=at)
    ours = messages.grid(Header(stamp_ns=stamp_ns, frame=frame), picture)
    stamp = header(stamp_ns, frame).stamp
    low_m = (rows + low_px - rows) * 0.05
    info = ros(
        "nav_msgs/msg/MapMetaData",
        map_load_time=stamp,
        resolution=0.05,
        width=columns,
        height=rows,
        origin=pose(left_px * 0.05, low_m, 0.0),
    )
    values = {OCCUPIED: 100, UNKNOWN: -1, FREE: 0}
    cells = [values[grey] for row in pixels[::-1].tolist() for grey in row]
    theirs = ros(
        name_of(GRID),
        header=header(stamp_ns, frame),
        info=info,
        data=np.array(cells, dtype=np.int8),
    )
    assert ours == serialized(GRID, theirs)


@derandomized
@given(fault=Texts | st.none(), detail=Texts, name=Texts.filter(bool), frame=st.just(""))
def test_diagnostics_are_byte_for_byte_those_of_another_serializer(
    fault: str | None, detail: str, name: str, frame: str
) -> None:
    sick = HealthPart(link="LOST", age_s=None, rate_hz=0.0, samples=0, errors=3, detail=detail)
    status = status_of(fault=fault, scanners={name: sick})
    payload = messages.diagnostics(Header(stamp_ns=7, frame=frame), status)
    read = deserialized(DIAGNOSTICS, payload)
    assert serialized(DIAGNOSTICS, read) == payload
    said: list[Any] = read.status
    first, parts = said[0], {one.name: one for one in said[1:]}
    assert first.level == (messages.WARN if fault else messages.OK)
    assert first.message == (f"localized: {fault}" if fault else "localized").replace("\x00", " ")
    assert first.hardware_id == "amr7"
    part = parts[f"amr_slam: {name}".replace("\x00", " ")]
    assert part.level == messages.ERROR
    assert {pair.key: pair.value for pair in part.values}["errors"] == "3"
    assert parts["amr_slam: wheels"].level == messages.OK


@pytest.mark.parametrize(
    ("state", "level"),
    [
        (State.STARTING, messages.WARN),
        (State.LOCALIZED, messages.OK),
        (State.MAPPING, messages.OK),
        (State.ODOMETRY_ONLY, messages.WARN),
        (State.AMBIGUOUS, messages.ERROR),
        (State.LOST, messages.ERROR),
    ],
)
def test_diagnostics_tell_what_the_pose_is_worth(state: State, level: int) -> None:
    status: StatusMessage = status_of(state=state)
    payload = messages.diagnostics(Header(stamp_ns=7, frame=""), status)
    read = deserialized(DIAGNOSTICS, payload)
    assert (read.status[0].level, read.status[0].message) == (level, str(state))


def test_stamps_that_ros_has_no_number_for_are_known() -> None:
    assert messages.fits(0)
    assert messages.fits((1 << 31) * 1_000_000_000 - 1)
    assert not messages.fits((1 << 31) * 1_000_000_000)
    assert not messages.fits(-1)


# -- reading


@derandomized
@given(
    before=st.lists(st.integers(-(2**31), 2**31 - 1), max_size=2),
    text=Texts,
    numbers=st.lists(Finite, min_size=1, max_size=4),
    after=st.integers(0, 2**32 - 1),
)
def test_what_is_written_is_read_again(
    before: list[int], text: str, numbers: list[float], after: int
) -> None:
    writer = CdrWriter()
    for value in before:
        writer.int32(value)
    writer.string(text)
    writer.float64s(*numbers)
    writer.uint32(after)
    payload = writer.bytes()
    reader = CdrReader(payload)
    assert [reader.int32() for _ in before] == before
    assert reader.string(1000) == text
    assert list(reader.float64s(len(numbers))) == numbers
    assert reader.uint32() == after
    reader.end()
    for size in range(len(payload)):
        with pytest.raises(WireError):
            read_all(payload[:size], len(before), len(numbers))


def read_all(payload: bytes, ints: int, doubles: int) -> None:
    reader = CdrReader(payload)
    for _ in range(ints):
        reader.int32()
    reader.string(1000)
    reader.float64s(doubles)
    reader.uint32()


def initialpose(
    frame: str = "map",
    planar: tuple[float, ...] = (0.25, 0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0, 0.07),
    **changes: Any,
) -> bytes:
    return serialized(POSE, ros_pose(5, frame, pose_of(covariance=planar, **changes)))


@derandomized
@given(x=Metres, y=Metres, theta=Angles)
def test_an_initial_pose_becomes_a_search_around_it(x: float, y: float, theta: float) -> None:
    command = read_initialpose(initialpose(x=x, y=y, theta=theta), "map")
    assert (command.x, command.y) == (x, y)
    assert math.isclose(math.cos(command.theta - theta), 1.0, abs_tol=1e-12)
    assert command.radius == pytest.approx(1.5)


def test_the_radius_is_three_sigmas_of_the_worst_direction_and_never_tiny() -> None:
    c = math.cos(0.6), math.sin(0.6)
    turned = np.array([c, (-c[1], c[0])]).T
    planar = np.zeros((3, 3))
    planar[:2, :2] = turned @ np.diag([4.0, 0.01]) @ turned.T
    command = read_initialpose(initialpose(planar=tuple(planar.ravel())), "map")
    assert command.radius == pytest.approx(6.0)
    assert read_initialpose(initialpose(planar=(0.0,) * 9), "map").radius == 0.5


def patched(offset: int, value: float) -> bytes:
    """An initial pose with another double at this place; 28: x, 28 + 56: the covariance."""
    payload = bytearray(initialpose())
    struct.pack_into("<d", payload, offset, value)
    return bytes(payload)


X, QX, QZ, QW, COVARIANCE = 4 + 16, 4 + 16 + 24, 4 + 16 + 40, 4 + 16 + 48, 4 + 16 + 56


@pytest.mark.parametrize(
    ("payload", "complaint"),
    [
        (b"", "no little-endian CDR"),
        (b"\x00\x00" + initialpose()[2:], "no little-endian CDR"),
        (b'{"x": 1}', "no little-endian CDR"),
        (initialpose()[:-1], "the payload ends too early"),
        (initialpose() + bytes(4), "4 bytes too many"),
        (initialpose(frame="odom"), "in frame 'odom', not in 'map'"),
        (initialpose(frame=""), "in frame '', not in 'map'"),
        (initialpose(frame="x" * 200), "a string of 201 bytes, at most 128"),
        (
            b"\x00\x01\x00\x00" + bytes(8) + b"\xff\xff\xff\xff" + b"map\x00",
            "a string of 4294967295",
        ),
        (b"\x00\x01\x00\x00" + bytes(8) + b"\x04\x00\x00\x00mapX", "a string without its end"),
        (b"\x00\x01\x00\x00" + bytes(8) + b"\x02\x00\x00\x00\xff\x00", "a string that is no UTF-8"),
        (patched(X, math.nan), "a number in it is not finite"),
        (patched(X, math.inf), "a number in it is not finite"),
        (patched(X, 1e6), "set_pose: x: Input should be less than or equal to 100000"),
        (patched(COVARIANCE + 8 * 20, math.nan), "a number in it is not finite"),
        (patched(COVARIANCE, -1.0), "a variance in it is negative"),
        (patched(COVARIANCE, 1e300), "set_pose: radius: Input should be less than or equal to"),
        (patched(COVARIANCE, 1.7e308), "set_pose: radius: "),
        (patched(QW, 5.0), "its orientation is no unit quaternion"),
        (patched(QW, 0.0), "its orientation is no unit quaternion"),
    ],
)
def test_what_is_no_place_in_the_map_is_refused_in_one_line(payload: bytes, complaint: str) -> None:
    with pytest.raises(WireError) as refused:
        read_initialpose(payload, "map")
    assert str(refused.value).startswith(complaint)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 250


def test_a_pose_that_leans_is_refused() -> None:
    payload = bytearray(initialpose(theta=0.0))
    struct.pack_into("<4d", payload, QX, math.sin(0.2), 0.0, 0.0, math.cos(0.2))
    with pytest.raises(WireError, match="does not stand upright"):
        read_initialpose(bytes(payload), "map")


@settings(derandomize=True, deadline=None, max_examples=300)
@given(payload=st.binary(max_size=500), at=st.integers(0, 363), octets=st.binary(max_size=8))
def test_junk_is_refused_or_is_a_pose_within_bounds(payload: bytes, at: int, octets: bytes) -> None:
    good = initialpose()
    for junk in (payload, good[:4] + payload, good[:at] + octets + good[at + len(octets) :]):
        try:
            command = read_initialpose(junk, "map")
        except WireError:
            continue
        assert isinstance(command, SetPose)
        assert abs(command.x) <= 1e5
        assert 0.5 <= command.radius <= 1e4
