"""Bytes and frames that no sound device sends, or that are for somebody else: refused by a line
that says why, or let pass, and what comes after them is understood."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cola_telegrams import scan_data, telegram

from amr_drivers.can_odometry.cia402 import objects
from amr_drivers.can_odometry.cia402.decoder import Cia402Decoder
from amr_drivers.can_odometry.cia402.settings import NodeSettings
from amr_drivers.can_odometry.cia402.settings import Settings as Cia402Settings
from amr_drivers.can_odometry.counting import Limits, SteerAngle
from amr_drivers.can_odometry.dbc import MAX_DBC_BYTES
from amr_drivers.can_odometry.dbc_decoder import DbcDecoder
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import Settings as DbcSettings
from amr_drivers.can_odometry.settings import WheelSettings
from amr_drivers.emulators.cia402 import EmulatedDrives
from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.fields import fields
from amr_drivers.sick_cola.framing import AnyReader, ColaAReader, ColaBReader, Dialect
from amr_drivers.sick_cola.messages import output_range
from amr_drivers.sick_cola.scandata import decode_scan, encode_scan
from amr_drivers.sick_s300.request_decoder import RequestDecoder
from amr_drivers.sick_s300.requests import (
    Answer,
    Block,
    Command,
    decode_block,
    decode_request,
    encode_answer,
    encode_request,
    fetch_scan,
    get_token,
    request_bytes,
    scan_block,
    scan_words,
)
from amr_drivers.sick_s300.scan_counter import ScanCounter
from amr_drivers.sick_s300.settings import Settings as S300Settings
from amr_drivers.sick_s300.telegrams import Output, Telegram, TelegramReader, encode, encode_words
from amr_drivers.sick_safety.cola2 import (
    Frame as Cola2Frame,
)
from amr_drivers.sick_safety.cola2 import (
    FrameReader,
    begun_frame,
    decode_frame,
    encode_frame,
    read_variable,
)
from amr_drivers.sick_safety.datagrams import Reassembler, fragments

MS = 1_000_000
BEAMS = 40
WORDS = np.arange(100, 100 + BEAMS, dtype=np.uint16)

# -- S300 -----------------------------------------------------------------------------------------


def s300_telegram(number: int) -> bytes:
    return encode(
        Telegram(
            address=7,
            version=0x0103,
            status=0,
            scan_number=number.to_bytes(4, "little"),
            telegram_number=number.to_bytes(2, "little"),
            output=Output.MEASURED,
            payload=encode_words(WORDS),
        )
    )


def test_a_payload_of_odd_length_is_no_telegram() -> None:
    odd = Telegram(
        address=7,
        version=0x0103,
        status=0,
        scan_number=bytes(4),
        telegram_number=bytes(2),
        output=Output.MEASURED,
        payload=encode_words(WORDS) + b"\0",
    )
    with pytest.raises(BadTelegram, match="no telegram has"):
        encode(odd)


def test_bytes_after_a_gap_are_not_joined_to_those_before_it() -> None:
    """What would be one whole telegram by its length is two halves of different ones."""
    reader = TelegramReader(BEAMS)
    first, second, third = (s300_telegram(n) for n in (1, 2, 3))
    half = len(first) // 2
    assert list(reader.feed(first[:half])) == []
    reader.reset()
    heard = list(reader.feed(second[half:] + third))
    assert [one.scan_number for one in heard] == [(3).to_bytes(4, "little")]
    # Positions go on in the stream that was sent, so that arrival times fit.
    assert heard[0].offset == half + len(second) - half


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda data: b"\1" + data[1:], "not the beginning"),
        (lambda data: data[:2] + b"\x99" + data[3:], "command type 99 is unknown"),
        (lambda data: data[:-1] + bytes((data[-1] ^ 1,)), "repeated header or CRC"),
    ],
    ids=["start", "command", "CRC"],
)
def test_a_request_that_is_damaged_is_not_obeyed(change: object, why: str) -> None:
    assert callable(change)
    request = encode_request(get_token(7))
    assert request_bytes(request) == len(request)  # a SEND: its data follow
    fetch = encode_request(fetch_scan(7, BEAMS))
    assert request_bytes(fetch) == len(fetch)
    assert decode_request(request).command is Command.SEND
    with pytest.raises(BadTelegram, match=why):
        decode_request(change(request))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda data: b"\1" + data[1:], "not the beginning of a block"),
        (lambda data: data[:-2], "bytes are no block of"),
        (lambda data: data[:-1] + bytes((data[-1] ^ 1,)), "CRC is wrong"),
    ],
    ids=["start", "length", "CRC"],
)
def test_a_block_that_is_damaged_is_no_scan(change: object, why: str) -> None:
    assert callable(change)
    block = scan_block(WORDS, 7)
    data = encode_answer(Answer(code=0, block=block))
    assert decode_block(data) == block
    with pytest.raises(BadTelegram, match=why):
        decode_block(change(data))


def test_another_block_or_another_number_of_beams_is_no_scan() -> None:
    block = scan_block(WORDS, 7)
    np.testing.assert_array_equal(scan_words(block, BEAMS), WORDS)
    other = Block(number=11, address=7, payload=block.payload)
    with pytest.raises(BadTelegram, match="block 11 holds no scan"):
        scan_words(other, BEAMS)
    with pytest.raises(BadTelegram, match="40 values instead of 41: check the field of view"):
        scan_words(block, BEAMS + 1)


def test_an_answer_that_was_thrown_away_counts_and_the_next_one_is_heard() -> None:
    told = S300Settings(port="/dev/null", mode="request", field_of_view_deg=0.5 * (BEAMS - 1))
    decoder = RequestDecoder("front", told, 0)
    assert decoder.facts() == ()
    assert decoder.max_age_s > decoder.silence_s >= 2.0 * decoder.answer_limit_s
    decoder.gap()  # nothing was under way
    assert decoder.status(0)[0] == 0
    decoder.sent(encode_request(decoder.dialogue.next_request), 0)
    decoder.gap()
    assert decoder.status(0)[0] == 1
    decoder.received(encode_answer(Answer(code=0)), MS)  # of the request that was given up
    decoder.sent(encode_request(decoder.dialogue.next_request), 2 * MS)
    assert decoder.waits
    decoder.received(encode_answer(Answer(code=0)), 3 * MS)
    assert not decoder.waits
    assert not decoder.refused


def test_a_number_that_grows_little_in_neither_order_tells_no_order() -> None:
    """00 00 00 00 to 01 00 00 01: little by neither order; then to a number that tells."""
    counter = ScanCounter()
    assert counter.read(bytes(4)) is None
    assert not counter.repeats(bytes((1, 0, 0, 1)))
    assert counter.read(bytes((1, 0, 0, 1))) is None
    assert counter.repeats(bytes((1, 0, 0, 1)))
    assert counter.read(bytes((2, 0, 0, 1))) == 0x01000002


# -- CoLa A and B ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("read", "data", "why"),
    [
        (lambda f: f.unsigned(16), b"10000", "does not fit into 16 bits"),
        (lambda f: f.unsigned(16), b"-1", "does not fit into 16 bits"),
        (lambda f: f.signed(16), b"12345", "does not fit into 16 bits"),
        (lambda f: f.letters(5), b"DIST", "has not 5 characters"),
        (lambda f: f.text(), b"9 short", "no text of 9 characters"),
        (lambda f: f.text(), b"5 a\x01b\x02c", "is no text"),
        (lambda f: f.values(3, 16), b"1 2", "no 3 values are left"),
        (lambda f: f.values(3, 16), b"1 22222", "cut short: 2 values instead of 3"),
        (lambda f: f.values(2, 8), b"1 100", "bits"),
    ],
)
def test_a_text_field_that_holds_something_else_is_refused(
    read: object, data: bytes, why: str
) -> None:
    assert callable(read)
    with pytest.raises(BadTelegram, match=why):
        read(fields(data, Dialect.A))


@pytest.mark.parametrize("dialect", list(Dialect))
def test_no_values_are_no_bytes(dialect: Dialect) -> None:
    read = fields(b"", dialect)
    assert len(read.values(0, 16)) == 0
    read.end()


def test_an_output_range_of_several_sectors_is_refused() -> None:
    body = b"\0\2" + bytes(24)
    with pytest.raises(BadTelegram, match="2 sectors instead of 1"):
        output_range(body, Dialect.B)


def test_more_encoders_than_any_device_has_are_not_read() -> None:
    """The number is from outside: nothing is made by it before it is checked."""
    body = bytearray(encode_scan(scan_data(encoders=()), Dialect.B))
    at = _encoder_count_at()
    assert body[at : at + 2] == b"\0\0"
    body[at : at + 2] = b"\xff\xff"
    with pytest.raises(BadTelegram, match="65535 encoders"):
        decode_scan(bytes(body), Dialect.B)


def _encoder_count_at() -> int:
    head_bits = (16, 16, 32, 8, 8, 16, 16, 32, 32, 8, 8, 8, 8, 16, 32, 32)
    return sum(head_bits) // 8


@pytest.mark.parametrize("dialect", list(Dialect))
@pytest.mark.parametrize("any_dialect", [False, True], ids=["told", "found out"])
def test_a_telegram_that_was_cut_by_a_gap_spoils_no_other(
    dialect: Dialect, any_dialect: bool
) -> None:
    whole = telegram(scan_data(), dialect, "sSN")
    own = ColaAReader() if dialect is Dialect.A else ColaBReader()
    reader = AnyReader() if any_dialect else own
    assert list(reader.feed(whole[: len(whole) // 2])) == []
    reader.reset()
    assert len(list(reader.feed(whole))) == 1
    # ... and one that comes byte by byte is heard with its last one.
    heard = [len(list(reader.feed(whole[n : n + 1]))) for n in range(len(whole))]
    assert sum(heard[:-1]) == 0
    assert heard[-1] == 1


# -- CoLa 2 and datagrams -------------------------------------------------------------------------


def test_what_is_no_cola_2_telegram_is_named() -> None:
    whole = encode_frame(read_variable(1, 2, 179))
    assert decode_frame(whole) == read_variable(1, 2, 179)
    with pytest.raises(BadTelegram, match=r"bytes of a CoLa 2 telegram of"):
        decode_frame(whole + b"\0")
    with pytest.raises(BadTelegram, match="no CoLa 2 telegram begins with"):
        begun_frame(b"\2\2\2\3" + whole[4:])
    with pytest.raises(BadTelegram, match="bytes are no CoLa 2 telegram"):
        begun_frame(whole[:12])
    with pytest.raises(BadTelegram, match="no frame has"):
        encode_frame(replace(read_variable(1, 2, 179), address=b"\1"))


@pytest.mark.parametrize(
    ("frame", "index"),
    [
        (read_variable(1, 2, 179), 179),
        (Cola2Frame(session=1, request=2, command="RA", payload=b"\x0f"), None),
        (Cola2Frame(session=1, request=2, command="OA"), None),
    ],
)
def test_a_telegram_names_a_variable_or_none(frame: Cola2Frame, index: int | None) -> None:
    assert frame.index == index


def test_half_a_cola_2_telegram_is_given_up_and_counted() -> None:
    whole = encode_frame(read_variable(1, 2, 179))
    reader = FrameReader()
    reader.reset()
    assert reader.damaged == 0  # nothing had begun
    assert list(reader.feed(whole[:10])) == []
    reader.reset()
    assert reader.damaged == 1
    assert list(reader.feed(whole)) == [read_variable(1, 2, 179)]


def test_a_start_too_short_for_its_hubs_address_is_skipped() -> None:
    """A length that only a telegram without an address can have, and an address announced."""
    whole = encode_frame(read_variable(1, 2, 179))
    least = bytearray(encode_frame(Cola2Frame(session=1, request=2, command="OA")))
    least[9] = 1
    reader = FrameReader()
    assert list(reader.feed(bytes(least) + whole)) == [read_variable(1, 2, 179)]
    assert reader.damaged == 1


def test_only_so_many_instances_are_remembered() -> None:
    """Repeated datagrams are known by those that came last; older ones are forgotten."""
    assembling = Reassembler()
    held = []
    for number in range(40):
        data = bytes((number,)) * 100
        (datagram,) = fragments(data, number)
        whole = assembling.feed(datagram, number * MS)
        assert whole is not None
        assert whole.data == data
        assert assembling.feed(datagram, number * MS) is None
        held.append(assembling.held_bytes)
    assert held[-1] == held[-2] == max(held)
    assert assembling.lost == 0
    # One that lacks a fragment is given up by the next whole one.
    first, _ = fragments(bytes(2000), 100)
    assert assembling.feed(first, 41 * MS) is None
    (datagram,) = fragments(bytes(100), 101)
    assert assembling.feed(datagram, 42 * MS) is not None
    assert assembling.lost == 1


# -- CAN ------------------------------------------------------------------------------------------

NODE = NodeSettings(node=1, counts_per_revolution=65536, gear_ratio=20.0)
DRIVES = Cia402Settings(left=NODE, right=replace(NODE, node=2, sign=-1))


def frame(identifier: int, data: bytes, **more: object) -> Frame:
    return replace(Frame(stamp_ns=MS, identifier=identifier, data=data), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (frame(objects.HEARTBEAT + 1, b""), "node 1: heartbeat of 0 bytes"),
        (frame(objects.EMCY + 2, b"\x10\x23\0"), "node 2: EMCY of 3 bytes"),
    ],
)
def test_a_drives_message_of_another_length_is_refused(bad: Frame, why: str) -> None:
    decoder = Cia402Decoder(DRIVES, 0)
    assert decoder.received(bad) == []
    assert decoder.status(MS) == (1, why)


@pytest.mark.parametrize(
    "other",
    [
        frame(objects.HEARTBEAT + 5, b"\x05"),
        frame(0x580 + 1, bytes(8)),
        frame(objects.HEARTBEAT + 1, b"", is_extended=True),
        frame(0x181, b"", is_remote=True),
    ],
    ids=["another node", "SDO", "29 bits", "remote"],
)
def test_frames_about_something_else_are_no_errors(other: Frame) -> None:
    decoder = Cia402Decoder(DRIVES, 0)
    assert decoder.received(other) == []
    assert decoder.status(MS)[0] == 0


def test_drives_that_say_what_no_wheel_can_do_are_not_believed() -> None:
    turning = replace(NODE, measures="velocity")
    told = Cia402Settings(left=turning, right=replace(turning, node=2))
    drives, decoder = EmulatedDrives(told, started=True), Cia402Decoder(told, 0)
    samples, angles = [], {"left": 0.0, "right": 0.0}
    for n in range(1, 6):
        angles = {name: angle + 0.02 * (400.0 if n > 3 else 4.0) for name, angle in angles.items()}
        for one in drives.cycle(n * 20 * MS, angles, 0.02):
            samples += decoder.received(one)
    assert "the wheel cannot turn at 400 rad/s" in str(decoder.status(100 * MS)[1])
    assert samples
    assert all(sample.stamp_ns <= 60 * MS + MS for sample in samples)


def test_a_position_beyond_its_modulus_is_refused() -> None:
    drives = EmulatedDrives(DRIVES, started=True)
    wrapping = replace(NODE, modulus_counts=4096)
    decoder = Cia402Decoder(replace(DRIVES, left=wrapping), 0)
    for one in drives.cycle(20 * MS, {"left": 2.0, "right": 0.0}, 0.02)[:1]:
        decoder.received(one)
    assert "wraps at 4096" in str(decoder.status(20 * MS)[1])


def test_a_steering_angle_is_a_position() -> None:
    with pytest.raises(ValueError, match="a steering angle is a position"):
        Cia402Settings(drive=NODE, steer=replace(NODE, node=2, measures="velocity"))


def test_a_steering_angle_of_the_same_instant_is_not_newer() -> None:
    steering = SteerAngle(Limits())
    assert steering.update(MS, 0.1)
    assert not steering.update(MS, 0.2)
    assert steering.angle_at(MS) == 0.1
    assert steering.update(2 * MS, 0.1 + 2.0 * math.pi)
    assert steering.angle_at(2 * MS) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("identifier", "data", "text"),
    [
        (0x004, b"\0\0", None),
        (0x004 | 0x080, b"\0\0", "bus errors"),
        (0x004, b"\0\x01", "frames lost: the interface's buffer ran over"),
        (0x002, b"\0\0", None),
    ],
    ids=["no trouble", "another class", "overflow", "arbitration"],
)
def test_error_frames_tell_what_goes_on(identifier: int, data: bytes, text: str | None) -> None:
    decoder = Cia402Decoder(DRIVES, 0)
    decoder.received(frame(0x20000000 | identifier, data, is_error=True, is_extended=True))
    assert decoder.status(MS) == (1, text)


J1939 = """VERSION ""
BS_:
BU_: Node
BO_ 2566848254 Broadcast: 8 Node
 SG_ Left : 0|16@1+ (1,0) [0|0] "" Vector__XXX
 SG_ Right : 16|16@1+ (1,0) [0|0] "" Vector__XXX
BO_ 2565804065 ToOne: 8 Node
 SG_ LeftOne : 0|16@1+ (1,0) [0|0] "" Vector__XXX
 SG_ RightOne : 16|16@1+ (1,0) [0|0] "" Vector__XXX
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566848254 3;
BA_ "VFrameFormat" BO_ 2565804065 3;
"""


@pytest.mark.parametrize(
    ("message", "suffix", "identifier", "same", "others"),
    [
        # To all, its source left open (0xFE): of any priority, from anybody.
        ("Broadcast", "", 0x18FEFEFE, (0x1C000000, 0xFF), (0x100, 0x10000)),
        # To one from one: of any priority, to anybody, from this source only.
        ("ToOne", "One", 0x18EF1021, (0x1C000000, 0xFF00), (0x1, 0x10000)),
    ],
)
def test_which_frames_of_j1939_are_meant(
    tmp_path: Path,
    message: str,
    suffix: str,
    identifier: int,
    same: tuple[int, ...],
    others: tuple[int, ...],
) -> None:
    dbc = tmp_path / "j1939.dbc"
    dbc.write_text(J1939)
    left, right = (
        WheelSettings(message=message, signal=f"{side}{suffix}") for side in ("Left", "Right")
    )
    settings = DbcSettings(channel="can0", dbc=str(dbc), left=left, right=right)
    decoder = DbcDecoder(settings, 0)
    (wanted,) = decoder.filters
    own = frame(identifier, bytes(8), is_extended=True)
    for bits in (0, *same):
        assert wanted.lets_pass(replace(own, identifier=identifier & ~bits))
    for bits in others:
        assert not wanted.lets_pass(replace(own, identifier=identifier ^ bits))


def test_a_dbc_file_too_large_to_be_one_is_not_read(tmp_path: Path) -> None:
    large = tmp_path / "large.dbc"
    with large.open("wb") as stream:
        stream.truncate(MAX_DBC_BYTES + 1)
    told = DbcSettings(
        channel="can0",
        dbc=str(large),
        left=WheelSettings(signal="Left"),
        right=WheelSettings(signal="Right"),
    )
    with pytest.raises(ValueError, match=rf"large.dbc: larger than {MAX_DBC_BYTES} bytes"):
        DbcDecoder(told, 0)
