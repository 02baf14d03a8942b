"""Raw channels to the byte, the ring in its bounds, and files that were cut off."""

from __future__ import annotations

import random
import re
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from amr_slam.cli import main
from amr_slam.recording import (
    About,
    RecordedDevice,
    RecordingError,
    RecordingWriter,
    read_log,
)
from amr_slam.recording.messages import Entry, encode_published
from amr_slam.recording.raw import RAW_SCHEMA, decode_raw, encode_raw
from amr_slam.recording.ring import Ring
from amr_slam.samples import Raw, RawBytes, RawFrame, Way

fixed = settings(
    derandomize=True,
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
ABOUT = About(robot="amr7", version="0.1", monotonic_ns=5, utc_ns=7, config='[robot]\nname = "ä"\n')
FRONT = RecordedDevice(
    name="front", kind="scanner", driver="sick_s300", settings='{"port": "/dev/ttyS0"}'
)
WHEELS = RecordedDevice(
    name="wheels", kind="odometry", driver="can", settings="{}", files={"dbc": b"\x00\xff" * 50}
)
LAMP = replace(FRONT, kind="lamp")  # type: ignore[arg-type]  # as only a file can have it

stamps = st.integers(0, 2**63 - 1)
names = st.sampled_from(["front", "wheels"])
passed = st.one_of(
    st.builds(
        RawBytes,
        device=names,
        stamp_ns=stamps,
        way=st.sampled_from([Way.RECEIVED, Way.SENT]),
        data=st.binary(max_size=200),
    ),
    st.builds(RawBytes, device=names, stamp_ns=stamps, way=st.sampled_from([Way.GAP, Way.OPENED])),
    st.builds(
        RawFrame,
        device=names,
        stamp_ns=stamps,
        identifier=st.integers(0, 2**29 - 1),
        is_extended=st.booleans(),
        is_remote=st.booleans(),
        is_error=st.booleans(),
        data=st.binary(max_size=64),
    ),
)


@fixed
@given(things=st.lists(passed, min_size=1, max_size=30))
def test_raw_messages_give_back_every_bit_in_their_order(tmp_path: Path, things: list[Raw]) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.describe(ABOUT, [FRONT, WHEELS])
        for thing in things:
            writer.write_raw(thing)
    log = read_log(path)
    assert log.raw == tuple(things)
    assert log.about == ABOUT
    heard = {thing.device for thing in things}
    assert log.devices == tuple(device for device in (FRONT, WHEELS) if device.name in heard)


@fixed
@given(data=st.binary(max_size=40))
def test_any_bytes_are_a_raw_message_or_a_value_error(data: bytes) -> None:
    try:
        thing = decode_raw("front", 1, data)
    except ValueError:
        return
    assert encode_raw(thing) == data


@pytest.mark.parametrize(
    "message",
    [
        b"",
        struct.pack("<BBII", 0, 0, 0, 9) + b"short",
        struct.pack("<BBII", 0, 0, 0, 2**32 - 1),
        struct.pack("<BBII", 2, 0, 0, 1) + b"x",
        struct.pack("<BBII", 5, 0, 0, 0),
        struct.pack("<BBII", 0, 1, 0, 0),
        struct.pack("<BBII", 4, 0, 1 << 29, 0),
        struct.pack("<BBII", 4, 8, 1, 0),
        struct.pack("<BBII", 4, 0, 1, 65) + bytes(65),
    ],
)
def test_hostile_raw_messages_are_refused(tmp_path: Path, message: bytes) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.describe(ABOUT, [FRONT])
        writer.add(Entry("/raw/front", RAW_SCHEMA, 1, message))
    with pytest.raises(RecordingError, match="damaged recording"):
        read_log(path)


@pytest.mark.parametrize(
    ("device", "about", "reason"),
    [
        (LAMP, ABOUT, "/raw/front: its metadata must be kind, driver"),
        (replace(FRONT, driver="x" * 65), ABOUT, "too long"),
        (replace(FRONT, settings="x" * (1 << 20) + "y"), ABOUT, "too long"),
        (FRONT, replace(ABOUT, utc_ns=-1), "no instants"),
        (FRONT, replace(ABOUT, utc_ns=9 * 10**18), "distant future"),
        (FRONT, replace(ABOUT, config="x" * (1 << 20) + "y"), "too long"),
    ],
)
def test_hostile_metadata_are_refused(
    tmp_path: Path, device: RecordedDevice, about: About, reason: str
) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.describe(about, [device])
        writer.write_raw(RawBytes(device="front", stamp_ns=1, way=Way.RECEIVED, data=b"x"))
    with pytest.raises(RecordingError, match=re.escape(reason)):
        read_log(path)


def test_a_device_that_was_not_described_is_not_written(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run.mcap") as writer, pytest.raises(KeyError, match="front"):
        writer.write_raw(RawBytes(device="front", stamp_ns=1, way=Way.GAP))


def test_settings_that_do_not_fit_end_replay_with_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.mcap"
    bad = replace(FRONT, settings='{"port": "/dev/ttyS0", "beams": "many"}')
    with RecordingWriter(path) as writer:
        writer.describe(ABOUT, [bad])
        writer.write_raw(RawBytes(device="front", stamp_ns=1, way=Way.RECEIVED, data=b"x"))
    assert main(["replay", str(path)]) == 1
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "error: " in line]
    assert line.endswith(
        f'{path}: /raw/front: settings: beams: should be a valid integer, not "many"'
    )


def test_other_readers_find_everything(tmp_path: Path) -> None:
    """The reference library, by the file's own index."""
    path = tmp_path / "run.mcap"
    with RecordingWriter(path) as writer:
        writer.describe(ABOUT, [FRONT, WHEELS])
        for stamp_ns in range(20_000):
            writer.write_raw(
                RawBytes(device="front", stamp_ns=stamp_ns, way=Way.RECEIVED, data=b"telegram" * 8)
            )
        writer.add(encode_published("pose", 20_000, b'{"v":1}'))
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 20_001
        assert len(summary.chunk_indexes) > 3
        channels = {channel.topic: channel for channel in summary.channels.values()}
        assert channels["/raw/front"].message_encoding == "ros1"
        assert summary.schemas[channels["/raw/front"].schema_id].encoding == "ros1msg"
        assert channels["/raw/wheels"].metadata["driver"] == "can"
        assert sum(1 for _ in reader.iter_messages(topics=["/raw/front"])) == 20_000
        (attached,) = reader.iter_attachments()
        assert (attached.name, attached.data) == ("wheels/dbc", WHEELS.files["dbc"])
        (metadata,) = reader.iter_metadata()
        assert metadata.metadata["robot"] == "amr7"


def test_what_a_power_cut_leaves_is_read_up_to_the_cut(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    whole = tuple(
        RawBytes(
            device="front",
            stamp_ns=n,
            way=Way.RECEIVED,
            data=bytes((n * k * k >> 3) % 256 for k in range(100)),
        )
        for n in range(20_000)
    )
    with RecordingWriter(path) as writer:
        writer.describe(ABOUT, [FRONT])
        for thing in whole:
            writer.write_raw(thing)
    data = path.read_bytes()
    found = []
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(data[: round(share * len(data))])
        caplog.clear()
        log = read_log(path)
        assert "cut off" in caplog.text
        assert log.raw == whole[: len(log.raw)]
        assert log.devices == (FRONT,)
        assert log.about == ABOUT
        found.append(len(log.raw))
    assert 0 < found[0] < found[1] < found[2] < len(whole)


@fixed
@given(
    sizes=st.lists(st.integers(0, 3000), min_size=1, max_size=120),
    max_kb=st.integers(1, 200),
    span_s=st.sampled_from([1.0, 10.0, 1e6]),
)
def test_a_ring_keeps_the_newest_in_order_and_within_its_bounds(
    sizes: list[int], max_kb: int, span_s: float
) -> None:
    ring = Ring(span_s, max_kb * 1000)
    added = []
    for n, size in enumerate(sizes):
        now_ns = n * 1_000_000_000
        # Bytes that do not pack well.
        data = bytes((n * k * (k + size) >> 4) % 256 for k in range(size))
        added.append(Entry(f"/raw/{n % 3}", RAW_SCHEMA, now_ns, data))
        ring.add(added[-1:], now_ns)
        # The open part is beside the bound.
        assert ring.used_bytes <= max(max_kb * 1000, (64 << 10) + 3100)
    kept = [entry for part in ring.kept(now_ns).parts() for entry in part]
    assert kept == added[len(added) - len(kept) :]
    if span_s == 1e6 and sum(sizes) < 1000:
        assert kept == added


def test_a_full_ring_holds_as_much_as_it_may() -> None:
    dice = random.Random(1)
    ring = Ring(1e6, 1_000_000)
    for n in range(50):
        ring.add([Entry("/raw/front", RAW_SCHEMA, n, dice.randbytes(70_000))], n)
        assert ring.used_bytes <= 1_000_000
    stamps = [entry.stamp_ns for part in ring.kept(50).parts() for entry in part]
    assert stamps == list(range(36, 50))


def test_a_ring_forgets_by_time() -> None:
    ring = Ring(10.0, 10**9)
    for second in range(100):
        entry = Entry("/raw/front", RAW_SCHEMA, second, bytes(70_000))
        ring.add([entry], second * 1_000_000_000)
    stamps = [e.stamp_ns for part in ring.kept(99_000_000_000).parts() for e in part]
    assert stamps == list(range(89, 100))
