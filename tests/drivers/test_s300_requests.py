from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import SHARED

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.dialogue import Dialogue
from amr_drivers.sick_s300.request_decoder import RequestDecoder
from amr_drivers.sick_s300.requests import (
    ERROR_TEXTS,
    Answer,
    AnswerReader,
    Block,
    Command,
    Request,
    decode_block,
    decode_request,
    encode_answer,
    encode_request,
    error_text,
    fetch_scan,
    get_token,
    release_token,
    scan_block,
    scan_words,
)
from amr_drivers.sick_s300.settings import Settings
from amr_drivers.sick_s300.telegrams import (
    Output,
    Telegram,
    encode,
    encode_words,
    ranges_from_words,
    standby_words,
)
from amr_slam.samples import Scan

BEAMS = 40
MS = 1_000_000
SICK = SHARED / "data/sick"
WORDS = np.arange(100, 100 + BEAMS, dtype=np.uint16)
GRANTED = encode_answer(Answer(code=0))
SCAN = encode_answer(Answer(code=0, block=scan_block(WORDS, 7)))


def capture(name: str) -> bytes:
    if not (SICK / name).exists():
        pytest.skip(f"{SICK / name} is absent")
    return (SICK / name).read_bytes()


@pytest.mark.parametrize(
    ("name", "request_"),
    [
        ("s300_request_get_token.bin", get_token(7)),
        ("s300_request_release_token.bin", release_token(7)),
        ("s300_request_fetch_block12.bin", fetch_scan(7, 541)),
    ],
)
def test_requests_of_real_hosts(name: str, request_: Request) -> None:
    raw = capture(name)
    assert encode_request(request_) == raw
    assert decode_request(raw) == request_


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (get_token(7), "00004144190000 05FF07190000 05FF07070F9FD0"),
        (release_token(7), "0000414419000005FF0719000005FF070000E7B8"),
        (get_token(8), "0000414419000005FF0819000005FF08070FAEFC"),
        (release_token(8), "0000414419000005FF0819000005FF080000D694"),
        (fetch_scan(7, 541), "000045440C000222FF07"),
        (fetch_scan(7, 761), "000045440C0002FEFF07"),
        (fetch_scan(8, 381), "000045440C000182FF08"),
    ],
)
def test_requests_are_those_of_the_fact_sheet(request_: Request, text: str) -> None:
    assert encode_request(request_) == bytes.fromhex(text)


def test_a_real_block_is_read_and_written() -> None:
    raw = capture("s3000_manual_reply_block11.bin")
    block = decode_block(raw)
    expect = _expected("s3000_manual_reply_block11.bin")
    assert (block.number, block.address) == (11, 7)
    assert len(raw) == 4 + 2 * expect["size_words"]
    assert int.from_bytes(raw[-2:], "little") == int(expect["crc"], 16)
    assert encode_answer(Answer(code=0, block=block)) == raw
    request = Request(command=Command.FETCH, block=11, address=7, size=expect["size_words"])
    assert AnswerReader(request).feed(raw) == Answer(code=0, block=block)
    with pytest.raises(BadTelegram, match="holds no scan"):
        scan_words(block, 541)


def test_the_shared_synthetic_answer_decodes_to_its_index_entry() -> None:
    name = "synthetic_s300/polled_block12_reply_541.bin"
    raw, expect = capture(name), _expected(name)
    assert len(raw) == fetch_scan(7, expect["n"]).answer_bytes
    answer = AnswerReader(fetch_scan(7, expect["n"])).feed(raw)
    assert answer is not None
    assert answer.block is not None
    words = scan_words(answer.block, expect["n"])
    assert np.rint(100 * ranges_from_words(words)[:3]).tolist() == expect["first3_cm"]
    for beam, bit in expect["flags"].items():
        assert words[int(beam)] >> int(bit.removeprefix("bit")) & 1
    assert encode_answer(answer) == raw


def _expected(name: str) -> dict[str, Any]:
    entries: list[dict[str, Any]] = json.loads((SICK / "index.json").read_text())
    expect: dict[str, Any] = next(e for e in entries if e["file"] == name)["expect"]
    return expect


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.data())
def test_damage_makes_no_false_answer(data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(SCAN) - 1))
    hit = data.draw(st.binary(min_size=1, max_size=2))  # a burst that the CRC always finds
    broken = bytearray(SCAN)
    for n, byte in enumerate(hit[: len(SCAN) - at]):
        broken[at + n] ^= byte or 1
    cuts = sorted(data.draw(st.lists(st.integers(0, len(SCAN)), max_size=20)))
    whole = _read([bytes(broken)])
    assert _read([bytes(broken[a:b]) for a, b in pairwise([0, *cuts, len(SCAN)])]) == whole
    assert whole is None or whole.code != 0


def _read(pieces: list[bytes]) -> Answer | None:
    reader = AnswerReader(fetch_scan(7, BEAMS))
    try:
        for piece in pieces:
            if (answer := reader.feed(piece)) is not None:
                return answer
    except BadTelegram:
        return None
    return None


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.binary(max_size=60))
def test_any_bytes_are_a_request_or_refused(data: bytes) -> None:
    try:
        request = decode_request(data)
    except BadTelegram:
        return
    assert encode_request(request) == data


@pytest.mark.parametrize(
    "block",
    [
        Block(number=12, address=8, payload=SCAN[10:-2]),
        Block(number=11, address=7, payload=SCAN[10:-2]),
        Block(number=12, address=7, payload=SCAN[10:-4]),
    ],
)
def test_an_answer_to_another_request_is_refused(block: Block) -> None:
    with pytest.raises(BadTelegram, match="another request"):
        AnswerReader(fetch_scan(7, BEAMS)).feed(encode_answer(Answer(code=0, block=block)))


def test_every_error_code_has_words() -> None:
    assert error_text(0x04) == "error 04: token already taken"
    assert error_text(0x99) == "error 99: not documented"
    assert len(set(ERROR_TEXTS.values())) == len(ERROR_TEXTS)


def test_the_token_is_taken_kept_and_given_back() -> None:
    dialogue = Dialogue(7, BEAMS)
    assert dialogue.farewell is None
    assert dialogue.next_request == get_token(7)
    dialogue.sent(get_token(7))
    assert dialogue.farewell == release_token(7)  # its answer may be lost
    dialogue.answered(get_token(7), Answer(code=0))
    for code in (0, 6, 0):  # busy: asked again
        assert dialogue.next_request == fetch_scan(7, BEAMS)
        dialogue.answered(fetch_scan(7, BEAMS), Answer(code=code))
    dialogue.sent(release_token(7))
    assert dialogue.farewell is None


def test_a_token_left_over_is_released_and_got_anew() -> None:
    dialogue = Dialogue(8, BEAMS)
    dialogue.answered(get_token(8), Answer(code=4))
    assert dialogue.next_request == release_token(8)
    dialogue.answered(release_token(8), Answer(code=0))
    assert dialogue.next_request == get_token(8)
    dialogue.answered(get_token(8), Answer(code=0))
    dialogue.answered(fetch_scan(8, BEAMS), Answer(code=2))  # switched off and on meanwhile
    assert dialogue.next_request == get_token(8)


class Line:
    """A decoder whose requests are answered by a script, on a clock of its own."""

    def __init__(self, **changes: object) -> None:
        self.settings = Settings(port="x", mode="request", beams=BEAMS, **changes)  # type: ignore[arg-type] # any field
        self.decoder = RequestDecoder("front", self.settings, 0)
        self.now_ns = 0

    def ask(self, answer: bytes, after_ms: int = 20) -> list[Scan]:
        """One request, and its answer in two pieces that far apart."""
        self.decoder.sent(encode_request(self.decoder.dialogue.next_request), self.now_ns)
        self.now_ns += after_ms * MS
        scans = self.decoder.received(answer[:7], self.now_ns)
        self.now_ns += 10 * MS
        return scans + self.decoder.received(answer[7:], self.now_ns)

    @property
    def said(self) -> str | None:
        return self.decoder.status(self.now_ns)[1]


def test_a_scan_is_stamped_by_the_first_byte_of_its_answer() -> None:
    line = Line()
    assert line.ask(GRANTED) == []
    (scan,) = line.ask(SCAN)
    # First byte at 50 ms: sweep 30 ms, and half of the 40 ms between two sweeps.
    assert scan.stamp_ns == (50 - 30 - 20) * MS
    assert scan.seq is None
    np.testing.assert_allclose(scan.ranges_m, 0.01 * WORDS)
    # The next sweep ended within the 30 ms since that answer began.
    other = encode_answer(Answer(code=0, block=scan_block(WORDS + np.uint16(1), 7)))
    (scan,) = line.ask(other)
    assert scan.stamp_ns == (80 - 30 - 15) * MS
    # All in one read, as an adapter gives it that held the bytes back: at 9600 Bd the first byte
    # came earlier than the last one by the time of all of them.
    slow = Line(baud_rate=9600)
    slow.ask(GRANTED)
    slow.decoder.sent(encode_request(slow.decoder.dialogue.next_request), slow.now_ns)
    (scan,) = slow.decoder.received(SCAN, slow.now_ns + 140 * MS)
    wire_ms = 10_000 * len(SCAN) / 9600
    assert scan.stamp_ns == slow.now_ns + round((140 - wire_ms - 50) * MS)


def test_what_a_line_holds_back_is_not_younger_for_it() -> None:
    line = Line()
    line.ask(GRANTED)
    blocks = [
        encode_answer(Answer(code=0, block=scan_block(WORDS + np.uint16(k), 7))) for k in range(4)
    ]
    (prompt,) = line.ask(blocks[0])
    asked_ns = line.now_ns
    # 60 ms later than the one before: 40 ms may be a sweep that was waited for, the rest is not.
    (held,) = line.ask(blocks[1], after_ms=80)
    assert held.stamp_ns - asked_ns == (80 - 30 - 20 - 20) * MS
    errors = line.decoder.status(line.now_ns)[0]
    assert line.ask(blocks[2], after_ms=200) == []
    assert line.said == "an answer came 0.14 s late: how old is its scan?"
    assert line.decoder.status(line.now_ns)[0] == errors + 1
    assert len(line.ask(blocks[3])) == 1
    assert line.said is None
    assert prompt.stamp_ns < held.stamp_ns


def test_what_hinders_is_said() -> None:
    line = Line()
    line.ask(encode_answer(Answer(code=4)))
    assert line.said is None  # left over from a program that died: taken over
    line.ask(GRANTED)
    line.ask(encode_answer(Answer(code=4)))
    assert line.said == "the scanner refuses: error 04: token already taken"
    line.ask(GRANTED)
    line.ask(GRANTED)
    standby = scan_block(standby_words(BEAMS), 7)
    assert line.ask(encode_answer(Answer(code=0, block=standby))) == []
    assert line.said == "standby"
    assert line.decoder.status(line.now_ns)[0] == 1
    assert len(line.ask(SCAN)) == 1
    assert line.said is None
    assert line.ask(SCAN) == []  # asked again before the next sweep
    assert line.said is None
    assert [line.ask(SCAN) for _ in range(4)] == [[]] * 4
    assert line.said == "frozen: the same scan is answered again and again"
    line.ask(b"")
    line.now_ns += 400 * MS
    assert str(line.said).startswith("no answer for 0.4 s")
    line.ask(b"HTTP/1.1 400 Bad Request")
    line.now_ns += 400 * MS
    assert "bytes come that are no answer" in str(line.said)
    line.ask(_continuous())
    assert "it is in continuous mode" in str(line.said)


def test_a_late_answer_is_nobodys() -> None:
    line = Line()
    line.ask(GRANTED)
    errors = line.decoder.status(line.now_ns)[0]
    assert line.ask(SCAN, after_ms=400) == []
    assert line.decoder.waits
    assert len(line.ask(SCAN)) == 1
    assert line.decoder.status(line.now_ns)[0] == errors + 1
    assert line.decoder.received(SCAN, line.now_ns) == []  # nobody has asked


def test_lost_bytes_spoil_the_answer_under_way_alone() -> None:
    line = Line()
    line.ask(GRANTED)
    line.decoder.sent(encode_request(line.decoder.dialogue.next_request), line.now_ns)
    line.decoder.received(SCAN[:50], line.now_ns)
    line.decoder.gap()
    assert line.decoder.received(SCAN[50:], line.now_ns) == []
    assert len(line.ask(SCAN)) == 1
    assert line.decoder.status(line.now_ns) == (1, None)


def _continuous() -> bytes:
    return encode(
        Telegram(
            address=7,
            version=0x0103,
            status=0,
            scan_number=bytes((1, 0, 0, 0)),
            telegram_number=bytes(2),
            output=Output.MEASURED,
            payload=encode_words(WORDS),
        )
    )
