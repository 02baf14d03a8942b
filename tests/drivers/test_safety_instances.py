from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety.blocks import (
    CONTAMINATED,
    CONTAMINATION_WARNING,
    GLARE,
    INFINITE,
    REFLECTOR,
    VALID,
    Beams,
    DerivedValues,
    Header,
    Instance,
    Status,
    ranges_m,
)
from amr_drivers.sick_safety.datagrams import (
    HEADER,
    MAX_INSTANCE,
    MAX_OPEN,
    Fragment,
    Reassembler,
    decode_fragment,
    encode_fragment,
    fragments,
)
from amr_drivers.sick_safety.instance import decode_instance, decode_parts, encode_instance

DERIVED = DerivedValues(
    factor=1, beams=100, scan_time_ms=40, start_deg=-47.5, step_deg=0.390625, interbeam_us=43
)
STATUS = Status(safe_off=0x055, other_off=0xFF, reset_required=3, monitoring_cases=(1, 2, 3, 4))
S = 1_000_000_000


def instance(number: int = 7, beams: int = 100) -> Instance:
    dice = np.random.default_rng(number)
    return Instance(
        header=Header(
            version=("R", 2, 0, 0),
            serial_number=17_479_021,
            plug_number=17_469_324,
            channel=1,
            sequence=number + 1,
            scan_number=number,
            date=3,
            time_ms=22_740,
        ),
        status=STATUS,
        derived=replace(DERIVED, beams=beams),
        beams=Beams(
            distance=dice.integers(1, 65_535, beams, dtype=np.uint16),
            rssi=dice.integers(0, 256, beams, dtype=np.uint8),
            status=np.full(beams, VALID, dtype=np.uint8),
        ),
    )


@pytest.mark.parametrize("header_bytes", [52, 56, 76])
def test_round_trip_with_every_length_of_header(header_bytes: int) -> None:
    sent = instance()
    raw = encode_instance(sent, header_bytes=header_bytes)
    got = decode_instance(raw)
    assert got.header.status.offset == header_bytes
    assert (got.header.local_io is None) == (header_bytes == 52)
    assert got.status == sent.status
    assert got.derived == sent.derived
    assert got.beams is not None
    assert sent.beams is not None
    np.testing.assert_array_equal(got.beams.distance, sent.beams.distance)
    np.testing.assert_array_equal(got.beams.rssi, sent.beams.rssi)
    assert not got.beams.distance.flags.writeable
    assert encode_instance(got, header_bytes=header_bytes) == raw


def test_absent_blocks_are_none_and_a_channel_that_is_off_is_no_damage() -> None:
    bare = decode_instance(encode_instance(Instance(header=instance().header)))
    assert (bare.status, bare.derived, bare.beams) == (None, None, None)
    off = decode_instance(bytes(52))
    assert not off.header.enabled


@pytest.mark.parametrize(
    "bits",
    [
        (0, "standby"),
        (1, "contamination_warning"),
        (2, "contamination_error"),
        (3, "reference_contour"),
        (4, "manipulation"),
    ],
)
def test_status_bits_lie_where_the_fact_sheet_says(bits: tuple[int, str]) -> None:
    bit, name = bits
    raw = bytearray(encode_instance(instance()))
    raw[76] = 1 << (bit + 1)
    status = decode_instance(bytes(raw)).status
    assert status is not None
    assert getattr(status, name)
    assert not status.run_mode
    raw[76 + 15] = 2
    status = decode_instance(bytes(raw)).status
    assert status is not None
    assert (status.application_error, status.device_error) == (False, True)


def test_ranges_tell_measured_from_nothing_there_and_not_measured() -> None:
    bits = [VALID, VALID | REFLECTOR, VALID | CONTAMINATION_WARNING]
    bits += [INFINITE, VALID | INFINITE]
    bits += [0, VALID | GLARE, VALID | CONTAMINATED, INFINITE | CONTAMINATED]
    beams = Beams(
        distance=np.full(len(bits), 1234, dtype=np.uint16),
        rssi=np.zeros(len(bits), dtype=np.uint8),
        status=np.array(bits, dtype=np.uint8),
    )
    ranges = ranges_m(replace(DERIVED, factor=2, beams=len(bits)), beams)
    np.testing.assert_allclose(ranges[:3], 2.468)
    assert np.isposinf(ranges[3:5]).all()
    assert np.isnan(ranges[5:]).all()
    none = Beams(
        distance=np.zeros(1, dtype=np.uint16), rssi=beams.rssi[:1], status=beams.status[:1]
    )
    assert np.isnan(ranges_m(DERIVED, none)).all()


def test_every_cut_is_refused_and_what_is_there_stays_readable() -> None:
    raw = encode_instance(instance())
    end = len(raw) - 4  # the gap behind the last block
    for length in range(end):
        with pytest.raises(BadTelegram):
            decode_instance(raw[:length])
        if length >= 52:
            parts = decode_parts(raw[:length])
            assert parts.complaint is not None
            there = 0 if parts.instance.beams is None else len(parts.instance.beams)
            assert there == max(0, (length - parts.instance.header.beams.offset - 4) // 4)


def changed(at: int, data: bytes) -> bytes:
    raw = encode_instance(instance())
    return raw[:at] + data + raw[at + len(data) :]


@pytest.mark.parametrize(
    ("raw", "complaint"),
    [
        (changed(0, b"!"), "is no letter"),
        (changed(32, b"\x10\x00"), "lies within"),  # status within the header
        (changed(36, b"\x50\x00"), "lies within"),  # derived values within status
        (changed(40, b"\xf0\xff"), "bytes of an instance of"),
        (changed(44, b"\xf0\xff\x08\x00"), "bytes of an instance of"),  # a block that is not read
        (changed(42, b"\x08\x00"), "100 beams in a block of 8 bytes"),
        (changed(96, b"\x00\x00"), "factor 0"),
        (changed(98, b"\x63\x00"), "100 beams measured instead of 99"),
        (changed(98, b"\xff\xff"), "65535 beams"),
        (changed(100, b"\x00\x00"), "scan time 0"),
        (changed(108, b"\x00\x00\x00\x80"), "beams of -512 deg"),
        (changed(112, b"\xff\xff\xff\xff"), "a sweep of"),
        (changed(124, b"\xff\xff\xff\xff"), "beams in a block"),
    ],
)
def test_what_no_scanner_sends_is_refused(raw: bytes, complaint: str) -> None:
    with pytest.raises(BadTelegram, match=complaint):
        decode_instance(raw)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.integers(0, 2**32), st.binary(min_size=1, max_size=8))
def test_damage_never_does_more_than_bad_telegram(place: int, damage: bytes) -> None:
    raw = bytearray(encode_instance(instance()))
    at = place % 160
    raw[at : at + len(damage)] = damage
    try:
        got = decode_instance(bytes(raw))
    except BadTelegram:
        return
    if got.derived is not None and got.beams is not None:
        assert len(ranges_m(got.derived, got.beams)) == got.derived.beams


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.data(), st.sampled_from([HEADER + 1, 60, 200, 1460]))
def test_any_order_and_doubling_gives_the_same_instance(data: st.DataObject, size: int) -> None:
    raw = encode_instance(instance(beams=30))
    parts = fragments(raw, 9, size)
    again = data.draw(st.lists(st.sampled_from(parts), max_size=10))
    order = random.Random(data.draw(st.integers(0, 1000)))
    mixed = parts + again
    order.shuffle(mixed)
    reassembler = Reassembler()
    got = [done for datagram in mixed if (done := reassembler.feed(datagram, 5)) is not None]
    assert [done.data for done in got] == [raw]
    assert (got[0].identification, got[0].stamp_ns) == (9, 5)
    assert (reassembler.lost, reassembler.refused) == (0, 0)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.data())
def test_overlapping_fragments_that_agree_give_the_instance(data: st.DataObject) -> None:
    raw = encode_instance(instance(beams=10))
    spans = data.draw(
        st.lists(st.tuples(st.integers(0, len(raw) - 1), st.integers(1, 60)), max_size=15)
    )
    spans += [(start, 40) for start in range(0, len(raw), 40)]
    reassembler = Reassembler()
    got = []
    for start, length in data.draw(st.permutations(spans)):
        piece = raw[start : start + length]
        fragment = Fragment(identification=3, total=len(raw), offset=start, data=piece)
        got.append(reassembler.feed(encode_fragment(fragment), 0))
    assert [done.data for done in got if done is not None] == [raw]


def test_fragments_that_contradict_each_other_give_no_instance() -> None:
    raw = encode_instance(instance())
    first, *rest = fragments(raw, 1, 200)
    wrong = bytearray(first)
    wrong[HEADER + 60] ^= 1
    reassembler = Reassembler()
    assert reassembler.feed(first, 0) is None
    with pytest.raises(BadTelegram, match="contradict"):
        reassembler.feed(bytes(wrong), 0)
    assert all(reassembler.feed(datagram, 0) is None for datagram in rest)
    other = Fragment(identification=1, total=len(raw) + 1, offset=0, data=b"x")
    with pytest.raises(BadTelegram, match="contradict"):
        reassembler.feed(encode_fragment(other), 0)
    assert reassembler.refused == 2


def test_instances_interleave_and_the_older_unfinished_are_given_up() -> None:
    old, new = (fragments(encode_instance(instance(n)), n, 200) for n in (1, 2))
    reassembler = Reassembler()
    got = [
        reassembler.feed(datagram, 0)
        for pair in zip(old[1:], new[1:], strict=True)
        for datagram in pair
    ]
    assert got == [None] * len(got)
    done = reassembler.feed(new[0], 1)
    assert done is not None
    assert done.identification == 2
    assert done.stamp_ns == 0
    assert reassembler.lost == 1
    assert reassembler.feed(old[0], 1) is None


def test_a_device_that_starts_anew_may_use_old_identifications() -> None:
    reassembler = Reassembler()
    for number in (1, 2):
        for datagram in fragments(encode_instance(instance(number)), number):
            reassembler.feed(datagram, 0)
    raw = encode_instance(instance(5))
    assert [
        done.data for d in fragments(raw, 1) if (done := reassembler.feed(d, 9)) is not None
    ] == [raw]


def test_memory_is_bounded_and_time_ends_what_is_unfinished() -> None:
    reassembler = Reassembler()
    for number in range(1000):
        fragment = Fragment(identification=number, total=MAX_INSTANCE, offset=0, data=b"x")
        assert reassembler.feed(encode_fragment(fragment), number) is None
        assert reassembler.held_bytes <= 2 * MAX_OPEN * MAX_INSTANCE
    assert reassembler.lost == 1000 - MAX_OPEN
    late = Fragment(identification=5000, total=100, offset=0, data=b"x")
    reassembler.feed(encode_fragment(late), 3 * S)
    assert reassembler.held_bytes == 2 * 100
    reassembler.reset()
    assert reassembler.held_bytes == 0


@pytest.mark.parametrize(
    ("at", "data", "complaint"),
    [
        (0, b"X", "not a safety scanner's"),
        (4, b"X", "not a safety scanner's"),
        (6, b"\x02", "version 2"),
        (8, b"\x00\x00\x00\x00", "no instance has 0"),
        (8, b"\xff\xff\xff\xff", "no instance has 4294967295"),
        (16, b"\xff\xff\xff\xff", "lie beyond"),
    ],
)
def test_datagrams_that_are_no_fragments_are_refused(at: int, data: bytes, complaint: str) -> None:
    (raw,) = fragments(encode_instance(instance()), 1)
    with pytest.raises(BadTelegram, match=complaint):
        decode_fragment(raw[:at] + data + raw[at + len(data) :])
    reassembler = Reassembler()
    with pytest.raises(BadTelegram, match="holds no data"):
        reassembler.feed(raw[:HEADER], 0)
    assert reassembler.refused == 1
