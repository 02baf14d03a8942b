from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import SHARED

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety import variables
from amr_drivers.sick_safety.cola2 import (
    ERRORS,
    MAX_LENGTH,
    Command,
    Frame,
    FrameReader,
    begun_frame,
    call_method,
    close_session,
    decode_frame,
    encode_frame,
    error_code,
    error_text,
    open_session,
    read_variable,
)
from amr_drivers.sick_safety.instance import decode_instance, decode_parts

FOLDER = SHARED / "data/sick"
SESSION = 0xA09E8AAB

frames = st.builds(
    Frame,
    session=st.integers(0, 2**32 - 1),
    request=st.integers(0, 2**16 - 1),
    command=st.sampled_from(list(Command)).map(str),
    payload=st.binary(max_size=60),
    hub=st.integers(0, 255),
    address=st.sampled_from([b"", b"\x01\x02\x03\x04"]),
)


def recorded(name: str) -> bytes:
    if not (FOLDER / name).exists():
        pytest.skip(f"{FOLDER / name} is absent")
    return (FOLDER / name).read_bytes()


def expected(name: str) -> dict[str, Any]:
    entries = json.loads(recorded("index.json"))
    return dict(next(entry for entry in entries if entry["file"] == name)["expect"])


@pytest.mark.parametrize(
    ("name", "frame"),
    [
        ("open_session_req", open_session(1, 30)),
        ("open_session_ack", Frame(session=SESSION, request=1, command="OA")),
        ("read_latest_telegram_req", read_variable(SESSION, 3, 179)),
        ("close_session_req", close_session(SESSION, 4)),
        ("close_session_ack", Frame(session=SESSION, request=4, command="CA")),
        ("findme_req", call_method(0xB0362C2D, 2, 14, b"\x05\x00")),
        ("findme_ack", Frame(session=0xB0362C2D, request=2, command="AI", payload=b"\x0e\x00")),
        (
            "devicestatus_ack",
            Frame(session=0x59AC3F69, request=2, command="RA", payload=b"\x0f\x00\x03"),
        ),
    ],
)
def test_the_manuals_dumps_are_read_and_written(name: str, frame: Frame) -> None:
    raw = recorded(f"microscan3_{name}.bin")
    assert decode_frame(raw) == frame
    assert encode_frame(frame) == raw
    assert FrameReader().feed(raw) == [frame]


def test_the_configuration_of_a_real_device() -> None:
    frame = decode_frame(recorded("microscan3_config_metadata_ack.bin"))
    assert frame.index == variables.CONFIGURATION
    configuration = variables.decode_configuration(frame.data)
    assert configuration.checksum == 0x9E5489A3
    assert configuration.network_checksum == 0x481AEEF5
    assert configuration.digest.hex() == "29e50caa39643d32654f43ee3ffa179f"
    for length in range(len(frame.data)):
        with pytest.raises(BadTelegram):
            variables.decode_configuration(frame.data[:length])


def test_a_telegram_cut_short_gives_what_is_there_and_is_refused_as_a_whole() -> None:
    name = "microscan3_latest_telegram_TRUNCATED.bin"
    raw, expect = recorded(name), expected(name)
    with pytest.raises(BadTelegram, match="192 bytes of a CoLa 2 telegram of 760"):
        decode_frame(raw)
    frame, length = begun_frame(raw)
    assert (length, frame.index) == (expect["cola2_len"] + 8, variables.LATEST_TELEGRAM)
    with pytest.raises(BadTelegram, match="172 bytes of an instance of 736"):
        decode_instance(frame.data)
    parts = decode_parts(frame.data)
    assert parts.complaint == "172 bytes of an instance of 736"
    header = parts.instance.header
    letter, *version = header.version
    assert bytes((ord(letter), *version)).hex() == expect["version"]
    assert header.serial_number == expect["serial"]
    assert header.plug_number == expect["plug"]
    assert (header.channel, header.sequence) == (expect["channel"], expect["seq"])
    assert (header.scan_number, header.date) == (expect["scan"], expect["date"])
    assert header.time_ms == expect["time_ms"]
    assert header.local_io is not None
    blocks = {
        "status": header.status,
        "derived": header.derived,
        "meas": header.beams,
        "intrusion": header.fields,
        "app": header.application,
        "localio": header.local_io,
    }
    assert {n: [block.offset, block.size] for n, block in blocks.items()} == expect["blocks"]
    derived, beams, status = parts.instance.derived, parts.instance.beams, parts.instance.status
    assert derived is not None
    assert (derived.factor, derived.beams) == (expect["factor"], expect["beams"])
    assert derived.scan_time_ms == expect["scan_ms"]
    assert (derived.start_deg, derived.step_deg) == (expect["start_deg"], expect["res_deg"])
    assert derived.interbeam_us == expect["interbeam_us"]
    assert beams is not None
    assert len(beams) == 11  # of 48
    first = [
        {"mm": int(mm), "rssi": int(rssi), "status": int(bits)}
        for mm, rssi, bits in zip(beams.distance, beams.rssi, beams.status, strict=True)
    ]
    assert first[:3] == expect["first3"]
    assert status is not None
    assert status.run_mode
    assert not status.standby


@settings(derandomize=True, deadline=None)
@given(frames)
def test_round_trip(frame: Frame) -> None:
    assert decode_frame(encode_frame(frame)) == frame


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.lists(st.one_of(frames, st.binary(max_size=30)), max_size=8), st.data())
def test_any_split_gives_the_same_frames(parts: list[Frame | bytes], data: st.DataObject) -> None:
    stream = b"".join(part if isinstance(part, bytes) else encode_frame(part) for part in parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    whole, pieces = FrameReader(), FrameReader()
    expect = whole.feed(stream)
    got: list[Frame] = []
    for start, end in pairwise([0, *cuts, len(stream)]):
        got += pieces.feed(stream[start:end])
    assert got == expect
    assert pieces.damaged == whole.damaged


def test_noise_between_frames_is_skipped_and_counted() -> None:
    first, second = open_session(1, 60), read_variable(7, 2, 179)
    # A start without a frame, a length that no frame has, letters that no command has.
    noise = b"\x02\x02\x02\x02\x02\xff" + b"\x02\x02\x02\x02\xff\xff\xff\xff" + bytes(40)
    wrong = encode_frame(Frame(session=1, request=1, command="zz"))
    reader = FrameReader()
    got = reader.feed(encode_frame(first) + noise + wrong + b"\x02" + encode_frame(second))
    assert got == [first, second]
    assert reader.damaged >= 1


def test_memory_stays_bounded() -> None:
    reader = FrameReader()
    for piece in (b"\x02" * 100_000, bytes(100_000), b"\x02\x02\x02\x02\x00\x00\xff\xf0" * 20_000):
        reader.feed(piece)
        assert len(reader._buffer) <= 2 * MAX_LENGTH
    reader.reset()
    frame = open_session(1, 60)
    assert reader.feed(encode_frame(frame)) == [frame]


@pytest.mark.parametrize("order", ["little", "big"])
def test_errors_are_read_in_either_byte_order(order: Any) -> None:
    for code in ERRORS:
        frame = Frame(session=1, request=1, command="FA", payload=code.to_bytes(2, order))
        assert error_code(frame) == code
    assert "no session resources" in error_text(0x21)
    assert error_text(0x1234) == "unknown error code 0x1234"
    with pytest.raises(BadTelegram):
        error_code(Frame(session=1, request=1, command="FA", payload=b"\x01"))


def test_a_stream_is_asked_for_as_the_manual_says() -> None:
    stream = variables.Stream(
        channel=1, enabled=True, interface=4, receiver="192.168.1.100", port=6060, every_nth=2
    )
    raw = variables.encode_stream(stream)
    assert len(raw) == 28
    assert raw[8:12].hex() == "6401a8c0"  # the address, reversed
    assert raw[:6].hex() == "010000000104"
    assert raw[12:16].hex() == (6060).to_bytes(2, "little").hex() + "0200"
    assert raw[16:24] == bytes(8)  # all beams
    assert raw[24:26] == b"\x07\x00"  # status, derived values, beams
    assert variables.decode_stream(raw) == stream
    part = variables.encode_stream(
        variables.Stream(
            channel=0,
            enabled=True,
            interface=0,
            receiver="1.2.3.4",
            port=1,
            start_deg=-45.0,
            stop_deg=90.0,
        )
    )
    # 90 degrees ahead: -45 of the robot is 45 of the device.
    assert int.from_bytes(part[16:20], "little", signed=True) == 45 * 4_194_304
    assert int.from_bytes(part[20:24], "little", signed=True) == 180 * 4_194_304
    assert variables.decode_stream(part).stop_deg == 90.0
    for bad in (raw[:-1], raw + b"\0", b"\x04" + raw[1:], raw[:12] + bytes(2) + raw[14:]):
        with pytest.raises(BadTelegram):
            variables.decode_stream(bad)


def test_variables_round_trip_and_refuse_what_is_short() -> None:
    overview = variables.StatusOverview(
        version="R.1.0.0",
        device_state=3,
        configuration_state=2,
        application_state=1,
        power_on_count=17,
        time_ms=86_399_999,
        date=19_000,
        error_code=0x00C1_0002,
        error_time_ms=5,
        error_date=6,
    )
    raw = variables.encode_overview(overview)
    assert raw[12] == 17  # offsets of the fact sheet
    assert raw[4:7] == b"\x03\x02\x01"
    assert raw[24:28] == bytes.fromhex("0200c100")
    assert (raw[52], raw[56]) == (5, 6)
    assert variables.decode_overview(raw) == overview
    with pytest.raises(BadTelegram):
        variables.decode_overview(raw[:-1])
    with pytest.raises(BadTelegram):
        variables.decode_overview(bytes(58))
    assert variables.decode_text(variables.encode_text("nanoScan3")) == "nanoScan3"
    assert variables.decode_text(b"\x03\x00a\x00b") == "ab"
    with pytest.raises(BadTelegram):
        variables.decode_text(b"\x09\x00short")
    assert variables.actions(b"\x81\x00") == ("confirm or change the configuration", "wait")
    assert variables.model_of("NANS3-CAAZ30AN1") == "nanoScan3"
    assert variables.interface_of("NANS3-CAAZ30AN1") == 4
    assert variables.interface_of("MICS3-CBUZ40IZ1P01") == 1
    assert variables.interface_of("MICS3-ACAZ40AZ1P01") == 0
