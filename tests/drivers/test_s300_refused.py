"""Telegrams, requests and blocks that no sound S300 sends: refused by a line
that says why, or let pass, and what comes after them is understood."""

from __future__ import annotations

import numpy as np
import pytest

from amr_drivers.errors import BadTelegram
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

MS = 1_000_000
BEAMS = 40
WORDS = np.arange(100, 100 + BEAMS, dtype=np.uint16)


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
