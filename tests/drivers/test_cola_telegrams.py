from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cola_telegrams import channel, everything, scan_data, telegram
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import SHARED

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.framing import (
    MAX_PAYLOAD_A,
    MAX_PAYLOAD_B,
    AnyReader,
    ColaAReader,
    ColaBReader,
    Dialect,
    checksum,
    framed,
    reader,
)
from amr_drivers.sick_cola.meaning import exact_step_deg, ranges_of
from amr_drivers.sick_cola.messages import (
    FIRMWARE,
    IDENT,
    REFUSALS,
    SCAN,
    Message,
    OutputRange,
    Refusal,
    event_request,
    message,
    output_range,
    output_range_body,
    parse_message,
    read_request,
    refusal,
    texts,
    texts_body,
)
from amr_drivers.sick_cola.scandata import (
    Channel,
    DeviceTime,
    Encoder,
    Event,
    Position,
    ScanData,
    decode_scan,
    encode_scan,
)

CAPTURES = SHARED / "data/sick"
SCANS = (
    "lms111_colab_scan1.bin",
    "lms511_colab_scan1.bin",
    "tim781s_colab_scan.bin",
    "tim571_colaa_sRA.bin",
)
DIALECTS = list(Dialect)


def captured(name: str) -> tuple[bytes, dict[str, Any]]:
    if not (CAPTURES / "index.json").exists():
        pytest.skip(f"{CAPTURES} is absent")
    entries = json.loads((CAPTURES / "index.json").read_text())
    expect = next(entry for entry in entries if entry["file"] == name)["expect"]
    return (CAPTURES / name).read_bytes(), expect


def said(data: bytes) -> tuple[Message | Refusal, Dialect]:
    (frame,) = AnyReader().feed(data)
    return parse_message(frame.payload, frame.dialect), frame.dialect


# ---------------------------------------------------------------- recordings of real devices


@pytest.mark.parametrize("name", SCANS)
def test_captured_scans_decode_to_their_index_entries(name: str) -> None:
    raw, expect = captured(name)
    answer, dialect = said(raw)
    assert isinstance(answer, Message)
    assert answer.word == expect.get("kind", "sSN")
    scan = decode_scan(answer.body, dialect)
    fields = {
        "ver": scan.version,
        "devno": scan.device_number,
        "serial": scan.serial_number,
        "status": list(scan.status),
        "telcnt": scan.telegram_counter,
        "scancnt": scan.scan_counter,
        "t_up_us": scan.start_up_us,
        "t_tx_us": scan.transmission_us,
        "din": list(scan.inputs),
        "dout": list(scan.outputs),
        "layer": scan.layer_angle,
        "scanfreq": scan.scan_frequency,
        "measfreq": scan.measurement_frequency,
        "name": scan.device_name,
        "time": None,
    }
    known = {key: value for key, value in expect.items() if key in fields}
    assert {key: fields[key] for key in known} == known
    if "timestamp" in expect:
        assert scan.time == DeviceTime(*expect["timestamp"])
    for found, wanted in zip(scan.channels, expect["channels"], strict=True):
        assert (found.name, found.bits) == (wanted["name"], wanted["bits"])
        assert found.start_angle == round(1e4 * wanted["start_angle_deg"])
        assert found.angle_step == wanted["step_field"]
        assert len(found.values) == wanted["n"]
        assert found.values[:3].tolist() == wanted["first3"]
        assert found.values[-3:].tolist() == wanted["last3"]
        assert (found.scale, found.offset) == (1.0, 0.0)


@pytest.mark.parametrize("name", SCANS)
def test_captured_scans_are_written_as_they_were_read(name: str) -> None:
    raw, _ = captured(name)
    answer, dialect = said(raw)
    assert isinstance(answer, Message)
    body = encode_scan(decode_scan(answer.body, dialect), dialect)
    assert message(answer.word, answer.name, body, dialect) == raw


def test_captured_refusal() -> None:
    raw, expect = captured("sfa_0003_colab.bin")
    answer, dialect = said(raw)
    assert answer == Refusal(expect["code"])
    assert str(answer) == "sFA 3 (unknown variable)"
    assert refusal(expect["code"], dialect) == raw


def test_captured_requests_are_read_and_ours_are_like_them() -> None:
    raw, expect = captured("lms111_session_host_to_device.bin")
    reading = ColaBReader()
    requests = [parse_message(f.payload, f.dialect) for f in reading.feed(raw)]
    assert len(requests) == expect["frames"]
    assert reading.damaged == 0
    assert reading.pending == len(raw)
    assert Message("sRN", FIRMWARE, b"") in requests
    assert event_request(SCAN, Dialect.B, on=True) in raw
    assert read_request(FIRMWARE, Dialect.B) in raw


# ---------------------------------------------------------------- framing


def test_checksum_is_the_xor_of_all_bytes() -> None:
    rng = np.random.default_rng(1)
    for length in (0, 1, 2, 63, 64, 65, 127, 1000, 3545):
        data = rng.integers(0, 256, length).astype(np.uint8)
        assert checksum(data.tobytes()) == int(np.bitwise_xor.reduce(data, initial=0))


def test_five_02_in_a_row_are_a_checksum_and_a_header() -> None:
    first = next(
        frame
        for n in range(256)
        if (frame := telegram(scan_data(scan_counter=n), Dialect.B))[-1] == 0x02
    )
    reading = ColaBReader()
    assert [f.offset for f in reading.feed(first + first)] == [0, len(first)]
    assert reading.damaged == 0
    # The same behind a frame whose checksum is wrong: the five 02 stand alone.
    spoilt = bytearray(first)
    spoilt[40] ^= 1
    again = ColaBReader()
    found = again.feed(first + bytes(spoilt) + first)
    assert [f.offset for f in found] == [0, 2 * len(first)]
    assert again.damaged == 1


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_cut_telegram_costs_none_of_the_next(dialect: Dialect) -> None:
    whole = telegram(everything(), dialect)
    for cut in range(len(whole)):
        reading = reader(dialect)
        frames = reading.feed(whole + whole[:cut] + whole + whole)
        assert [f.payload for f in frames] == [frames[0].payload] * 3, cut
        assert reading.damaged == (cut > 0)


def test_a_flipped_bit_never_becomes_another_scan() -> None:
    whole = telegram(everything(), Dialect.B)
    for position in range(len(whole)):
        for bit in range(8):
            spoilt = bytearray(whole)
            spoilt[position] ^= 1 << bit
            payloads = {f.payload for f in ColaBReader().feed(whole + spoilt + 2 * whole)}
            assert whole[8:-1] in payloads
            # A length that is 2 too large passes the checksum, for that is the XOR of what it
            # covers and the next header begins with 02: what is left over gives it away.
            for payload in payloads - {whole[8:-1]}:
                answer = parse_message(payload, Dialect.B)
                assert isinstance(answer, Message)
                with pytest.raises(BadTelegram):
                    decode_scan(answer.body, Dialect.B)


def test_an_impossible_length_is_no_frame() -> None:
    payload = b"sRA LMDscandata " + bytes(100)
    huge = b"\x02\x02\x02\x02" + (MAX_PAYLOAD_B + 1).to_bytes(4, "big") + payload
    good = telegram(scan_data(), Dialect.B)
    assert len(ColaBReader().feed(huge + good)) == 1
    with pytest.raises(ValueError, match="too many"):
        framed(bytes(MAX_PAYLOAD_B + 1), Dialect.B)


def test_text_without_an_end_is_given_up() -> None:
    reading = ColaAReader()
    good = telegram(scan_data(), Dialect.A)
    frames = reading.feed(b"\x02sRA " + b"1" * (3 * MAX_PAYLOAD_A) + good)
    assert [f.payload for f in frames] == [good[1:-1]]
    with pytest.raises(ValueError, match="CoLa A"):
        framed(b"sRA X\x03", Dialect.A)


def test_the_first_frame_shows_the_dialect() -> None:
    for dialect in DIALECTS:
        reading = AnyReader()
        assert reading.feed(b"\x02noise\x00\x02\x02") == []
        assert reading.dialect is None
        assert reading.damaged == 0
        assert len(reading.feed(telegram(scan_data(), dialect))) == 1
        assert reading.dialect is dialect
        assert reading.feed(telegram(scan_data(), DIALECTS[dialect is Dialect.A])) == []


# ---------------------------------------------------------------- messages


@pytest.mark.parametrize("dialect", DIALECTS)
def test_all_refusals_have_names(dialect: Dialect) -> None:
    for code in REFUSALS:
        answer, _ = said(refusal(code, dialect))
        assert isinstance(answer, Refusal)
        assert answer.code == code
        assert "unknown code" not in str(answer)
    assert "unknown code" in str(Refusal(0x77))


def test_refusals_have_a_blank_in_cola_a_only() -> None:
    assert refusal(0x0F, Dialect.A) == b"\x02sFA F\x03"
    assert refusal(0x0F, Dialect.B)[8:-1] == b"sFA\x00\x0f"


@pytest.mark.parametrize("dialect", DIALECTS)
def test_small_answers(dialect: Dialect) -> None:
    names = ("LMS 10x", "V1.80")
    assert texts(texts_body(names, dialect), 2, dialect) == names
    part = OutputRange(5000, -449_997, 2_249_997)
    assert output_range(output_range_body(part, dialect), dialect) == part
    answer, _ = said(message("sRA", IDENT, texts_body(names, dialect), dialect))
    assert isinstance(answer, Message)
    assert (answer.word, answer.name) == ("sRA", IDENT)


@pytest.mark.parametrize(
    "payload", [b"", b"sRX LMD", b"sRN", b"sRN ", b"sRNLMD", b"sRN \xff", b"sFA"]
)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_what_is_no_message_is_refused(payload: bytes, dialect: Dialect) -> None:
    with pytest.raises(BadTelegram):
        parse_message(payload, dialect)


# ---------------------------------------------------------------- LMDscandata

u8, u16, u32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
i16, i32 = (st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (16, 32))
f32 = st.floats(width=32, allow_nan=False)
pair = st.tuples(u8, u8)
printable = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=40)


@st.composite
def channels(draw: st.DrawFn) -> Channel:
    bits = draw(st.sampled_from([8, 16]))
    top = 2**bits - 1
    return channel(
        name=draw(st.sampled_from(["DIST1", "DIST2", "RSSI1", "ANGL1", "VANG1"])),
        bits=bits,
        scale=draw(f32),
        offset=draw(f32),
        start_angle=draw(i32),
        angle_step=draw(u16),
        values=np.array(draw(st.lists(st.integers(0, top), max_size=12)), dtype=np.uint16),
    )


scans = st.builds(
    ScanData,
    version=u16,
    device_number=u16,
    serial_number=u32,
    status=pair,
    telegram_counter=u16,
    scan_counter=u16,
    start_up_us=u32,
    transmission_us=u32,
    inputs=pair,
    outputs=pair,
    layer_angle=i16,
    scan_frequency=u32,
    measurement_frequency=u32,
    encoders=st.lists(st.builds(Encoder, u32, u16), max_size=3).map(tuple),
    channels=st.lists(channels(), max_size=4).map(
        lambda found: tuple(sorted(found, key=lambda one: -one.bits))
    ),
    position=st.none() | st.builds(Position, f32, f32, f32, f32, f32, f32, u8),
    device_name=st.none() | printable,
    comment=st.none() | printable,
    time=st.none() | st.builds(DeviceTime, u16, u8, u8, u8, u8, u8, u32),
    event=st.none() | st.builds(Event, st.just("FDIN"), u32, u32, i32),
)


def same(a: ScanData, b: ScanData) -> bool:
    def plain(scan: ScanData) -> tuple[object, ...]:
        listed = [
            (c.name, c.bits, c.scale, c.offset, c.start_angle, c.angle_step, c.values.tolist())
            for c in scan.channels
        ]
        names = [name for name in ScanData.__dataclass_fields__ if name != "channels"]
        return (listed, *(getattr(scan, name) for name in names))

    return plain(a) == plain(b)


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("length_bits", [8, 16])
@settings(max_examples=200, derandomize=True, deadline=None)
@given(scan=scans)
def test_what_is_written_is_read(dialect: Dialect, length_bits: Any, scan: ScanData) -> None:
    assert same(decode_scan(encode_scan(scan, dialect, length_bits), dialect), scan)


@pytest.mark.parametrize("dialect", DIALECTS)
@settings(max_examples=100, derandomize=True, deadline=None)
@given(scan=scans)
def test_nothing_may_be_missing_or_left_over(dialect: Dialect, scan: ScanData) -> None:
    body = encode_scan(scan, dialect)
    for other in (body[:-1], body + (b" 0" if dialect is Dialect.A else b"\x00")):
        try:
            found = decode_scan(other, dialect)
        except BadTelegram:
            continue
        # In text a digit less is another number. In bytes an empty text's length may have one byte
        # or two, which says the same.
        assert same(found, scan) == (dialect is Dialect.B)


def test_decimal_and_hexadecimal_numbers_may_be_mixed() -> None:
    body = encode_scan(scan_data(), Dialect.A)
    decimal = body.replace(b"FFF92230", b"-450000").replace(b" 3E8 ", b" +1000 ")
    assert same(decode_scan(decimal, Dialect.A), scan_data())
    for nonsense in (b" 3_E8 ", b" 0x3E8 ", b" +3E8 ", b"  ", b" FFFFFFFFF ", b" 3E8g "):
        with pytest.raises(BadTelegram):
            decode_scan(body.replace(b" 3E8 ", nonsense), Dialect.A)


def test_a_name_with_a_blank_is_read_by_its_length() -> None:
    body = encode_scan(scan_data(device_name="not defined"), Dialect.A)
    assert b" 1 B not defined 0 0 0" in body
    assert decode_scan(body, Dialect.A).device_name == "not defined"


def test_values_that_do_not_fit_are_refused() -> None:
    body = encode_scan(scan_data(), Dialect.A)
    with pytest.raises(BadTelegram, match="16 bits"):
        decode_scan(body.replace(b" BB8", b" 10000"), Dialect.A)


# ---------------------------------------------------------------- meaning


@pytest.mark.parametrize(
    ("field", "step_deg"),
    [
        (3333, 1 / 3),
        (1667, 1 / 6),
        (1666, 1 / 6),
        (6667, 2 / 3),
        (833, 1 / 12),
        (417, 1 / 24),
        (10_000, 1.0),
        (5000, 0.5),
        (2500, 0.25),
        (1250, 0.125),
        (1000, 0.1),
        (500, 0.05),
        (1234, 0.1234),
        (83, 0.0083),
        (0, 0.0),
    ],
)
def test_rounded_steps_are_made_exact(field: int, step_deg: float) -> None:
    assert exact_step_deg(field) == pytest.approx(step_deg, abs=1e-12)


def test_codes_are_no_distances_and_scale_and_offset_count() -> None:
    raw = np.array([0, 1, 15, 16, 1000, 40_000, 65_535], dtype=np.uint16)
    ranges = ranges_of(channel(values=raw, scale=2.0, offset=500.0), 80.0)
    assert np.isnan(ranges[[0, 1, 2, 6]]).all()
    assert ranges[3:5] == pytest.approx([0.532, 2.5])
    assert ranges[5] == math.inf
    assert ranges_of(channel(values=raw, scale=0.1), 80.0)[4] == pytest.approx(0.1)


@pytest.mark.parametrize("changes", [{"scale": 0.0}, {"scale": math.inf}, {"offset": math.nan}])
def test_scales_that_make_no_distances_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(BadTelegram, match="scale"):
        ranges_of(channel(**changes), 80.0)


def test_the_first_echo_is_taken() -> None:
    echoes = tuple(channel(name=name) for name in ("RSSI1", "DIST3", "DIST1", "DIST2"))
    scan = scan_data(channels=echoes)
    for kind, name in (("DIST", "DIST1"), ("RSSI", "RSSI1")):
        found = scan.channel(kind)  # type: ignore[arg-type]
        assert found is not None
        assert found.name == name
    assert replace(scan, channels=()).channel("DIST") is None
