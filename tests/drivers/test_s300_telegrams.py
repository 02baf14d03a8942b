from __future__ import annotations

import json
import random
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import SHARED

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.scan_counter import ScanCounter
from amr_drivers.sick_s300.telegrams import (
    LENGTH_RULES,
    MAX_LENGTH,
    Output,
    Telegram,
    TelegramReader,
    crc16,
    encode,
    encode_words,
    is_standby,
    measured_words,
    ranges_from_words,
    standby_words,
    words_from_ranges,
)

BEAMS = 40  # short telegrams let hypothesis hit every byte
RULES = [(version, rule) for version, rules in LENGTH_RULES.items() for rule in rules]


def make(
    number: int,
    *,
    beams: int = BEAMS,
    version: int = 0x0102,
    address: int = 7,
    status: int = 0,
    output: Output = Output.MEASURED,
) -> Telegram:
    words = np.random.default_rng(number).integers(0, 3000, beams).astype(np.uint16)
    words[::2] = 0  # half of all words zero: the worst case for finding headers
    return Telegram(
        address=address,
        version=version,
        status=status,
        scan_number=number.to_bytes(4, "little"),
        telegram_number=(number % 65536).to_bytes(2, "little"),
        output=output,
        payload=encode_words(words),
    )


def same(a: Telegram, b: Telegram) -> bool:
    return replace(a, offset=0) == replace(b, offset=0)


def test_crc_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1


def test_crc_of_a_real_reply() -> None:
    file = SHARED / "data/sick/s3000_manual_reply_block11.bin"
    if not file.exists():
        pytest.skip(f"{file} is absent")
    raw = file.read_bytes()
    assert crc16(raw[4:-2]) == int.from_bytes(raw[-2:], "little") == 0x2C2D


def test_shared_synthetic_telegram_decodes_to_its_index_entry() -> None:
    folder = SHARED / "data/sick"
    if not (folder / "index.json").exists():
        pytest.skip(f"{folder} is absent")
    name = "synthetic_s300/v0102_541.bin"
    entries = json.loads((folder / "index.json").read_text())
    expect = next(entry for entry in entries if entry["file"] == name)["expect"]
    (telegram,) = TelegramReader(541).feed((folder / name).read_bytes())
    words = measured_words(telegram, 541)
    assert len(words) == expect["n"]
    assert np.rint(100 * ranges_from_words(words)[:3]).tolist() == expect["first3_cm"]
    for beam, bit in expect["flags"].items():
        assert words[int(beam)] >> int(bit.removeprefix("bit")) & 1


@pytest.mark.parametrize(("version", "rule"), RULES)
def test_length_rules_give_the_sizes_of_the_fact_sheet(version: int, rule: int) -> None:
    raw = encode(make(1, beams=541, version=version), rule)
    assert len(raw) == 1108
    assert int.from_bytes(raw[6:8], "big") == {4: 552, 8: 550, 14: 547}[rule]


@pytest.mark.parametrize(("version", "rule"), RULES)
@pytest.mark.parametrize("expected", [BEAMS, 541])
def test_round_trip_under_every_length_rule(version: int, rule: int, expected: int) -> None:
    sent = [make(number, version=version) for number in range(50)]
    got = TelegramReader(expected).feed(b"".join(encode(one, rule) for one in sent))
    assert len(got) == len(sent)
    assert all(same(a, b) for a, b in zip(sent, got, strict=True))
    assert [b.offset - a.offset for a, b in pairwise(got)] == [26 + 2 * BEAMS] * 49


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.data(), st.sampled_from(RULES))
def test_any_split_gives_the_same_telegrams(data: st.DataObject, kind: tuple[int, int]) -> None:
    version, rule = kind
    stream = b"\xff\x07" + b"".join(encode(make(n, version=version), rule) for n in range(6))
    damage = data.draw(st.lists(st.integers(0, len(stream) - 1), max_size=6))
    broken = bytes(0x5A if i in damage else byte for i, byte in enumerate(stream))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(broken)), max_size=40)))
    whole, pieces = TelegramReader(BEAMS), TelegramReader(BEAMS)
    expected = whole.feed(broken)
    got: list[Telegram] = []
    for start, end in pairwise([0, *cuts, len(broken)]):
        got += pieces.feed(broken[start:end])
    assert got == expected
    assert pieces.damaged == whole.damaged


def test_byte_by_byte_gives_the_same_telegrams() -> None:
    stream = b"".join(encode(make(n)) for n in range(5))
    reader = TelegramReader(BEAMS)
    got = [one for byte in stream for one in reader.feed(bytes((byte,)))]
    assert got == TelegramReader(BEAMS).feed(stream)
    assert len(got) == 5


@st.composite
def hits(draw: st.DrawFn, length: int) -> tuple[str, int, bytes]:
    kind = draw(st.sampled_from(["flip", "delete", "insert"]))
    return kind, draw(st.integers(0, length - 1)), draw(st.binary(min_size=1, max_size=40))


def strike(stream: bytes, hit: tuple[str, int, bytes]) -> bytes:
    kind, at, data = hit
    if kind == "insert":
        return stream[:at] + data + stream[at:]
    if kind == "delete":
        return stream[:at] + stream[at + len(data) :]
    changed = bytes(a ^ (b or 1) for a, b in zip(stream[at:], data, strict=False))
    return stream[:at] + changed + stream[at + len(changed) :]


@settings(derandomize=True, deadline=None, max_examples=400)
@given(st.data(), st.sampled_from(RULES))
def test_damage_makes_no_false_scan_and_costs_only_what_it_hits(
    data: st.DataObject, kind: tuple[int, int]
) -> None:
    version, rule = kind
    sent = [make(n, version=version) for n in range(8)]
    length = 26 + 2 * BEAMS
    stream = b"".join(encode(one, rule) for one in sent)
    hit = data.draw(hits(len(stream)))
    got = TelegramReader(BEAMS).feed(strike(stream, hit))
    touched = {hit[1] // length}
    if hit[0] != "insert":
        touched |= {min(hit[1] + len(hit[2]) - 1, len(stream) - 1) // length}
    elif hit[1] % length == 0:
        touched = set()  # between two telegrams: neither is hit
    missing = [n for n, one in enumerate(sent) if not any(same(one, other) for other in got)]
    assert set(missing) <= touched
    assert all(any(same(one, other) for one in sent) for other in got), "a false telegram"


def test_heavy_damage_of_full_telegrams_makes_no_false_scan() -> None:
    dice = random.Random(7)
    sent = {n: encode(make(n, beams=541, version=0x0103), 14) for n in range(300)}
    stream = bytearray()
    spoiled = set()
    for n, raw in sent.items():
        piece = raw
        if dice.random() < 0.3:
            spoiled.add(n)
            kind = dice.choice(["flip", "delete", "insert"])
            piece = strike(raw, (kind, dice.randrange(24, 1000), dice.randbytes(9)))
        stream += piece
    reader = TelegramReader(541)
    got = reader.feed(bytes(stream))
    numbers = {int.from_bytes(one.scan_number, "little") for one in got}
    assert numbers == set(sent) - spoiled
    for one in got:
        original = sent[int.from_bytes(one.scan_number, "little")]
        assert encode(replace(one, offset=0), 14) == original
    assert 0 < reader.damaged <= len(spoiled)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.lists(st.one_of(st.binary(max_size=300), st.just(bytes(500)), st.just(b"\xff" * 90))))
def test_noise_is_bounded_and_leaves_the_next_telegram_whole(noise: list[bytes]) -> None:
    reader = TelegramReader(BEAMS)
    for piece in noise:
        reader.feed(piece)
        assert reader.position - reader.pending <= 2 * MAX_LENGTH
    # Padding as long as the largest size that the noise can have announced.
    got = reader.feed(b"\x01" * MAX_LENGTH + encode(make(9)))
    assert [int.from_bytes(one.scan_number, "little") for one in got] == [9]


def test_a_telegram_cut_short_does_not_delay_the_next() -> None:
    reader = TelegramReader(541)
    whole = encode(make(2, beams=541))
    assert reader.feed(encode(make(1, beams=541))[:600] + whole[:500]) == []
    (got,) = reader.feed(whole[500:])
    assert same(got, make(2, beams=541))
    assert reader.damaged == 0  # a stream may begin in the middle of a telegram
    reader.feed(whole[:600] + whole)
    assert reader.damaged == 1


@pytest.mark.parametrize("lost", [7, 8, 11, 12, 21, 22, 23, 300])
def test_lost_bytes_make_no_scan_even_when_the_crc_agrees_by_chance(lost: int) -> None:
    first, second = bytearray(encode(make(1, beams=541))), encode(make(2, beams=541))
    joined = bytearray(first[: 1108 - lost] + second[:lost])
    crc = int.from_bytes(joined[-2:], "little")
    for word in range(65536):  # the one word that makes the wrong CRC right
        joined[100:102] = word.to_bytes(2, "little")
        if crc16(joined[4:-2]) == crc:
            break
    assert crc16(joined[4:-2]) == crc
    got = TelegramReader(541).feed(bytes(joined) + second[lost:])
    assert [one.scan_number[0] for one in got] == [2]


def test_the_other_length_rule_does_not_cut_a_telegram_even_when_its_crc_agrees() -> None:
    telegram = make(1, beams=541, version=0x0103)
    for word in range(65536):
        payload = telegram.payload[:100] + word.to_bytes(2, "little") + telegram.payload[102:]
        raw = encode(replace(telegram, payload=payload), 14)
        if crc16(raw[4:1100]) == int.from_bytes(raw[1100:1102], "little"):
            break
    assert crc16(raw[4:1100]) == int.from_bytes(raw[1100:1102], "little")
    (got,) = TelegramReader(541).feed(raw)
    assert len(measured_words(got, 541)) == 541


def test_a_damaged_size_does_not_delay_the_next_telegram() -> None:
    wrong = bytearray(encode(make(1, beams=541)))
    wrong[6:8] = (1900).to_bytes(2, "big")
    reader = TelegramReader(541)
    assert reader.feed(bytes(wrong)) == []  # it may become a telegram of 3804 bytes
    assert len(reader.feed(encode(make(2, beams=541)))) == 1


def test_an_endless_run_of_headers_is_read_in_linear_time() -> None:
    header = encode(make(1, beams=541))[:22]
    reader = TelegramReader(541)
    assert reader.feed(header * 20_000) == []  # quadratic: minutes, and pytest's time-out
    assert reader.damaged > 50


def test_host_and_guest_on_one_line_are_told_apart() -> None:
    stream = b"".join(encode(make(n, address=7 + n % 2)) for n in range(6))
    assert [one.address for one in TelegramReader(BEAMS).feed(stream)] == [7, 8] * 3


@pytest.mark.parametrize("output", [Output.IO, Output.REFLECTORS])
def test_other_outputs_are_recognised_and_not_sold_as_scans(output: Output) -> None:
    (telegram,) = TelegramReader(BEAMS).feed(encode(make(1, output=output)))
    assert telegram.output is output
    with pytest.raises(BadTelegram, match=output.name):
        measured_words(telegram, BEAMS)


def test_other_numbers_of_values_and_ranges_are_refused() -> None:
    (telegram,) = TelegramReader(541).feed(encode(make(1)))
    with pytest.raises(BadTelegram, match="40 values instead of 541"):
        measured_words(telegram, 541)
    with pytest.raises(BadTelegram, match="measuring range 1122"):
        measured_words(replace(telegram, payload=b"\x11\x22" + telegram.payload[2:]), BEAMS)


def test_value_words() -> None:
    words = np.array([0, 1, 0xE064, 2949, 2950, 0x1FFF, 0x4004], dtype=np.uint16)
    np.testing.assert_allclose(
        ranges_from_words(words), [np.nan, 0.01, 1.0, 29.49, np.inf, np.inf, 0.04]
    )
    assert not is_standby(words)
    assert is_standby(standby_words(541))
    ranges = np.array([np.nan, 0.01, 12.34, 29.4, np.inf])
    np.testing.assert_allclose(ranges_from_words(words_from_ranges(ranges)), ranges)


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("start", [0, 255, 65535, 0x01020304, 2**32 - 3])
def test_scan_number_order_is_found(order: str, start: int) -> None:
    counter = ScanCounter()
    sent = [(start + step) % 2**32 for step in (0, 1, 2, 4, 5, 30, 31)]
    raw = [n.to_bytes(4, "little" if order == "little" else "big") for n in sent]
    read = [counter.read(one) for one in raw]
    assert read[0] is None
    assert read[1:] == sent[1:]
